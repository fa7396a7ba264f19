"""Snapshots that are whole by their checksum and wrong inside: every array is held against the layout before a kernel
sees it.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import tracemalloc

import numpy as np
import pytest
from feeding import events_of, one_by_one

import navfilter as nf
from navfilter.faults.alternative_path import AlternativePath
from navfilter.kernels import fault_bank, strapdown
from navfilter.simulation.scenarios import simulate_scenario


@pytest.fixture(scope="module")
def dive():
    """A run that is kept in its first minutes: inputs of the beginning, listeners, samples at rest."""
    vehicle, mission = simulate_scenario("lawnmower", 1, 40.0)
    vehicle = vehicle.with_error(
        compass=nf.LearnedArma(prior=vehicle.sensors["compass"].error, window=400),
        gyro=vehicle.drive.gyro.parts[1] + nf.LearnedArma(prior=vehicle.drive.gyro.parts[0], window=1000),
    )
    nav = nf.Navigator(vehicle, mission.start)
    one_by_one(nav, [event for event in events_of(vehicle, mission) if event.time_s <= 20.0])
    return vehicle, nav.snapshot()


def resealed(data, change):
    """The snapshot with its content changed, under a right checksum."""
    magic, header, payload = data.split(b"\n", 2)
    with np.load(io.BytesIO(payload)) as archive:
        arrays = {name: archive[name].copy() for name in archive.files}
    meta = json.loads(arrays["meta"].tobytes())
    change(meta["fields"], arrays)
    arrays["meta"] = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    out = io.BytesIO()
    np.savez(out, **arrays)
    head = json.loads(header) | {"sha256": hashlib.sha256(out.getvalue()).hexdigest(), "size": len(out.getvalue())}
    return magic + b"\n" + json.dumps(head).encode() + b"\n" + out.getvalue()


def filter_of(saved):
    return saved["memory"]["fields"]["filter"]["fields"]


def learning_of(saved):
    return saved["memory"]["fields"]["learning"]["fields"]


def put(field, value):
    """Another value for elements of one of the filter's arrays."""

    def change(saved, arrays):
        place = filter_of(saved)[field]
        arrays["floats"][place["at"] + value[0]] = value[1]

    return change


def shape(field, other):
    return lambda saved, arrays: filter_of(saved)[field].update(shape=other)


def indefinite(saved, arrays):
    """Symmetric, with a correlation beyond 1."""
    place = filter_of(saved)["P"]
    n, at = place["shape"][0], place["at"]
    arrays["floats"][[at + 1, at + n]] = 10.0 * np.sqrt(arrays["floats"][at] * arrays["floats"][at + n + 1])


def pairs(*items):
    return {"": "tuple", "items": [{"": "tuple", "items": list(item)} for item in items]}


def channel_of(saved):
    """What is remembered of the faults of the first sensor."""
    return filter_of(saved)["monitor"]["fields"]["channels"]["items"][0][1]["fields"]


def beginning_of(saved):
    return learning_of(saved)["beginning"]["fields"]


def heads_of(saved, arrays):
    """What is kept of the first reading."""
    return arrays["floats"][beginning_of(saved)["readings"]["fields"]["pieces"][0]["at"] :]


def way_of(kind="AlternativePath", fields=None, **changed):
    own = {f.name: f.default for f in dataclasses.fields(AlternativePath)} if fields is None else fields
    return {"": kind, "fields": own | changed}


def bank(place, value):
    """Another value for an element of the bank of faults."""

    def change(saved, arrays):
        arrays["floats"][filter_of(saved)["monitor"]["fields"]["bank"]["at"] + place] = value

    return change


CHANGES = {
    "a bank of more faults than there is room for": bank(fault_bank.SIGNATURES, 1e6),
    "a fault of a state that does not exist": bank(fault_bank.ONSETS + fault_bank.WINDOWS + 1 + fault_bank.PLACE, 1e6),
    "faults that were looked for at no time": bank(fault_bank.LOOKED_S, np.nan),
    "faults since no time": bank(fault_bank.ONSETS, np.inf),
    "P of another shape": shape("P", [3, 3]),
    "P beyond the end": lambda saved, arrays: filter_of(saved)["P"].update(at=10**9),
    "P before the beginning": lambda saved, arrays: filter_of(saved)["P"].update(at=-(10**9)),
    "x too short": shape("x", [1]),
    "drv too short": shape("drv", [2]),
    "acc turned": lambda saved, arrays: filter_of(saved)["acc"].update(shape=filter_of(saved)["acc"]["shape"][::-1]),
    "NaN in P": put("P", (0, np.nan)),
    "a negative variance": put("P", (0, -1.0)),
    "an infinite latitude": put("nav", (0, np.inf)),
    "a radius of nothing": put("nav", (15, 0.0)),
    "an attitude that is no rotation": put("nav", (6, 2.0)),
    "a drive without a period": put("drv", (strapdown.PERIOD_S, 0.0)),
    "a transition larger than anything that moves": put("acc", (0, 1e23)),
    "P is not symmetric": put("P", (1, 1e9)),
    "a covariance that is none": indefinite,
    "P is a text": lambda saved, arrays: filter_of(saved).update(P="none"),
    "a time that is a text": lambda saved, arrays: filter_of(saved).update(time_s="soon"),
    "no time": lambda saved, arrays: filter_of(saved).pop("time_s"),
    "models of an unknown sensor": lambda saved, arrays: filter_of(saved).update(models=pairs(["x", 1])),
    "a channel too few": lambda saved, arrays: filter_of(saved)["channels"]["items"].pop(),
    "a channel of another shape": lambda saved, arrays: filter_of(saved)["channels"]["items"][0][1].update(shape=[3]),
    "a class of another kind": lambda saved, arrays: saved["memory"]["fields"].update(
        filter={"": "Popen", "fields": {}}
    ),
    "fewer inputs of the beginning": lambda saved, arrays: beginning_of(saved)["samples"]["fields"].update(count=3),
    "inputs of the beginning without numbers": lambda saved, arrays: beginning_of(saved)["values"]["fields"][
        "pieces"
    ].clear(),
    "inputs of the beginning of no sensor": lambda saved, arrays: heads_of(saved, arrays).__setitem__(1, 77.0),
    "an input of the beginning beyond their end": lambda saved, arrays: heads_of(saved, arrays).__setitem__(4, 1e9),
    "a beginning that is a list": lambda saved, arrays: learning_of(saved).update(beginning=[]),
    "a standard deviation of no input": lambda saved, arrays: beginning_of(saved)["sds"]["items"].append([10**6, 1.0]),
    "a ring of another shape": lambda saved, arrays: learning_of(saved)["listeners"]["items"][0][1]["fields"][
        "ring"
    ].update(shape=[1, 7]),
    "a block beyond its end": lambda saved, arrays: learning_of(saved)["rest"]["fields"].update(filled=10**6),
    "nothing at rest": lambda saved, arrays: learning_of(saved).update(rest=None),
    "an input with six columns": lambda saved, arrays: saved["inputs"].append({"": "floats", "at": 0, "shape": [2, 6]}),
    "a way of a refused velocity that is a number": lambda saved, arrays: channel_of(saved).update(way=1.5),
    "another value in its place": lambda saved, arrays: channel_of(saved).update(way=way_of("Turns", {})),
    "a way whose time is a text": lambda saved, arrays: channel_of(saved).update(way=way_of(time_s="soon")),
    "a watch too few": lambda saved, arrays: saved["watches"]["items"].pop(),
    "a watch that counts in texts": lambda saved, arrays: saved["watches"]["items"][0][1]["fields"]["others"][
        "items"
    ].append(["rejected", "often"]),
    "a watch whose figures are a text": lambda saved, arrays: saved["watches"]["items"][0][1]["fields"].update(
        figures="low"
    ),
    "bursts whose stamp is a list": lambda saved, arrays: saved["clock"]["fields"]["bursts"]["fields"].update(
        own_s=[1.0]
    ),
    "a heading told alone without a place": lambda saved, arrays: channel_of(saved).update(
        alone={"": "tuple", "items": [1.0]}
    ),
    "a history without end": lambda saved, arrays: saved.update(history_s=float("inf")),
    "no floats": lambda saved, arrays: arrays.update(floats=np.zeros(3)),
    "no meta": lambda saved, arrays: saved.clear(),
}


def test_unchanged_it_is_taken(dive):
    vehicle, data = dive
    again = nf.Navigator.restore(vehicle, resealed(data, lambda saved, arrays: None))
    assert again.time_s > 19.9


@pytest.mark.parametrize("why", CHANGES)
def test_what_does_not_fit_is_refused_in_words(dive, why):
    vehicle, data = dive
    with pytest.raises(ValueError, match=r"^the snapshot cannot be read \(.+\)\. Start afresh"):
        nf.Navigator.restore(vehicle, resealed(data, CHANGES[why]))


def compressed(data):
    magic, header, payload = data.split(b"\n", 2)
    with np.load(io.BytesIO(payload)) as archive:
        arrays = {name: archive[name] for name in archive.files}
    out = io.BytesIO()
    np.savez_compressed(out, **arrays | {"floats": np.zeros(10_000_000)})
    head = json.loads(header) | {"sha256": hashlib.sha256(out.getvalue()).hexdigest(), "size": len(out.getvalue())}
    return magic + b"\n" + json.dumps(head).encode() + b"\n" + out.getvalue()


def all_again_and_again(saved, arrays):
    everything = {"": "floats", "at": 0, "shape": [arrays["floats"].size]}
    saved["time_s"] = [everything] * (80_000_000 // (8 * arrays["floats"].size))


def all_but_one(saved, arrays):
    saved["time_s"] = [{"": "floats", "at": 0, "shape": [-1]}] * (80_000_000 // (8 * arrays["floats"].size))


@pytest.mark.parametrize(
    "bomb", [compressed, *(lambda data, c=c: resealed(data, c) for c in (all_again_and_again, all_but_one))]
)
def test_no_snapshot_takes_more_than_it_holds(dive, bomb):
    """Each of these would be 80 MB; what is read is the file and its arrays, twice over while they are checked."""
    vehicle, data = dive
    crafted = bomb(data)
    tracemalloc.start()
    with pytest.raises(ValueError, match="the snapshot cannot be read"):
        nf.Navigator.restore(vehicle, crafted)
    assert tracemalloc.get_traced_memory()[1] < 8 * len(data)
    tracemalloc.stop()
