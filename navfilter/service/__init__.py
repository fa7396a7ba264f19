"""The navigator as a service: readings in and states out as line-delimited JSON, a log that replays, snapshots."""
