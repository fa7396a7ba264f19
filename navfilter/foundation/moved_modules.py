"""Modules that have moved: what imports one by its old path is told the new one. Kept for one release."""

from __future__ import annotations

_PACKAGE = "navfilter."
#: Old path and new path, without the package.
_MOVED = """
alignment models.alignment, arma timeseries, arma.algebra timeseries.polynomials, arma.choice
timeseries.order_criterion, arma.continuous timeseries.continuous, arma.fit timeseries.fit, arma.gauss_markov
timeseries.gauss_markov, arma.model timeseries.model, arma.objective timeseries.likelihood, arma.online
timeseries.online, arma.online.bank timeseries.online.order_bank, arma.online.front_end
timeseries.online.preprocessing, arma.online.recursive timeseries.online.recursive, arma.online.window
timeseries.online.window, arma.order timeseries.order, arma.periodic_motion timeseries.periodic_motion, arma.problem
timeseries.regression, arma.roots timeseries.roots, arma.spectral timeseries.spectral, arma.starts
timeseries.initial_values, arma.stationary timeseries.stationary, assembly navigation.track_assembly, beacons
calibration.beacons, beginning navigation.early_rerun, calibration.words calibration.text, check.amounts
check.units_text, check.clocks check.time_units, check.far_clocks check.clock_offsets, check.north
check.magnetic_north, cli commands.cli, commands.selection commands.mission_part, compilation
kernels.compiling.progress, constants foundation.constants, cycle models.periodic_error, descriptions
foundation.frozen, diagnostics timeseries.diagnostics, error_models models.error_models, evaluation.constants
evaluation.calibration_states, evaluation.doubts evaluation.diagnostics, evaluation.left_out
evaluation.omitted_parameters, evaluation.rivals evaluation.baselines, evaluation.surfacing
evaluation.fix_reacquisition, evaluation.withheld playback.held_out, evaluation.wording evaluation.learned_text,
filter.adoption filter.model_change, filter.agreement faults.sensor_bias, filter.aside faults.velocity_fault,
filter.asking filter.python_update, filter.belief faults.bias_plausibility, filter.bursts faults.clocks.burst_stamps,
filter.channel filter.sensor_channel, filter.chi_square foundation.chi_square, filter.condition navigation.status,
filter.course faults.heading_fault, filter.described filter.channel_model, filter.drive_clock faults.clocks.imu_clock,
filter.drive_watch faults.imu.monitor, filter.gating faults.innovation_gate, filter.health faults.sensor_monitor,
filter.heights faults.depth_fault, filter.history navigation.history, filter.intake filter.imu_intake,
filter.integrity faults.protection_level, filter.iron faults.heading_fault, filter.jumps navigation.alternative,
filter.lane_choice faults.lane_selection, filter.layout filter.state_layout, filter.memory foundation.state_values,
filter.offsets models.fault_bias, filter.over_ground faults.ground_velocity, filter.ramp faults.velocity_evidence,
filter.realignment faults.imu.realignment, filter.reckoned faults.dead_reckoning_compass, filter.refusals
faults.sensor_bias, filter.refused faults.policy, filter.refused_way faults.alternative_path, filter.scatter
faults.noise_scale, filter.sensor_clock faults.clocks.sensor_clock, filter.shifts faults.fault_bank, filter.sight
filter.delayed_measurement, filter.slack faults.sensor_bias, filter.smoother filter.rts_smoother, filter.snapshot
navigation.snapshot, filter.spool filter.record_store, filter.tape filter.records, filter.transplant
navigation.lanes.state_transfer, filter.turns navigation.alternative, filter.waiting navigation.waiting, handed_over
foundation.arguments, identification.bands identification.cosine_spectrum, identification.lines
identification.spectral_lines, identification.reading models.interpretation, identification.sheet_page
identification.noise_sheet_page, identification.sheet_words identification.noise_sheet_text, identification.stillness
identification.static_detection, io.epoch io.mission_start, io.logs.carrying io.logs.sentence_times, io.logs.choosing
io.logs.topic_names, io.logs.gathering io.logs.record_columns, io.logs.known io.logs.known_topics, io.logs.shelf
io.logs.cache, io.merging io.stream_joining, io.native io.mission_npz, io.starting io.mission_start, io.where
io.table, kernels.addresses kernels.compiling.addresses, kernels.arma kernels.recursive_arma,
kernels.arma_window kernels.recursive_arma_window, kernels.channel kernels.arma_likelihood, kernels.decorators
kernels.compiling.decorators, kernels.drive_watch kernels.imu_checks, kernels.fit kernels.arma_fit, kernels.jumps
kernels.fault_bank, kernels.listen kernels.open_loop_residual, kernels.past kernels.delayed_state, kernels.registers
kernels.compiling.registers, kernels.scatter kernels.noise_scale, kernels.shifts kernels.fault_bank, kernels.stretch
kernels.batch, kernels.text kernels.number_text, known_calls kernels.compiling.type_cache, lane_clock
models.lane_clock, lane_missions models.lane_missions, lane_replay navigation.lanes.replay, lane_tracks
navigation.lanes.tracks, lanes navigation.lanes.navigator, learning.belief
learning.setup, learning.bias learning.model_reduction, learning.drift
models.navigation_drift, learning.effort learning.settings, learning.fit learning.arma_fit, learning.input_buffer
filter.input_buffer, learning.kept filter.input_buffer, learning.learned models.learned_arma,
learning.learner learning.axis_learner, learning.learnt
learning.learned_model, learning.limits models.window_limits, learning.listener learning.open_loop_series,
learning.listener_memory learning.series_memory, learning.low_frequency learning.arma_fit, learning.nearest
learning.moment_matching, learning.posterior learning.slow_posterior,
learning.refit learning.batch, learning.rest learning.static_recorder, learning.slow learning.slow_prior,
learning.spectrum models.spectrum, learning.starts learning.initial_values,
learning.worker learning.background, magnetic models.magnetic, mapped foundation.mapped_arrays, mechanisation
models.mechanisation, mechanisation.coasting models.mechanisation.dead_reckoning_lane, mechanisation.dead_reckoning
models.mechanisation.dead_reckoning, mechanisation.imu models.mechanisation.imu, mechanisation.mechanisation
models.mechanisation.mechanisation, mission models.mission, navigator navigation.navigator, navigator_memory
navigation.memory, notebook foundation.display, outputs io.tracks, outputs.formats io.tracks.formats, outputs.geojson
io.tracks.geojson, outputs.gpx io.tracks.gpx, outputs.kml io.tracks.kml, outputs.local io.tracks.local, outputs.mat
io.tracks.mat, outputs.netcdf io.tracks.netcdf, outputs.replacing io.tracks.atomic_files, outputs.ros io.tracks.ros,
outputs.rows io.tracks.rows, outputs.sbet io.tracks.sbet, outputs.table io.tracks.table, outputs.tum io.tracks.tum,
passage navigation.runner, passage_again navigation.runner, prompt navigation.live_runner, readings
navigation.measurements, recorded navigation.recorded_inputs, report.clock rendering.clock, report.drawing
rendering.drawing, report.page rendering.page, report.panels rendering.panels, report.thinning rendering.thinning,
sensors models.sensors, sensors.altitude models.sensors.altitude, sensors.attitude models.sensors.attitude,
sensors.beams models.sensors.beams, sensors.course models.sensors.course, sensors.heading models.sensors.heading,
sensors.odometer models.sensors.odometer, sensors.position models.sensors.position, sensors.ranges
models.sensors.ranges, sensors.sensor models.sensors.sensor, sensors.traits models.sensors.traits, sensors.turning
models.sensors.zero_rate, sensors.usbl models.sensors.usbl, sensors.velocity models.sensors.velocity, service.outlet
service.output, service.tally service.loop, start models.start, state models.state, track_bounds
navigation.track_bounds, track_plot track.plot, track_trust track.trust, track_views track.track, utc foundation.utc,
vehicle models.vehicle, warming playback.warm_up
"""


def refuse_moved(name: str) -> None:
    """Refuse a module that is not there any more.

    Parameters
    ----------
    name : str
        Full name of a module that nobody has found.

    Raises
    ------
    ImportError
        For one that has moved; it names the new path.

    Examples
    --------
    >>> import navfilter.sensors
    Traceback (most recent call last):
    ...
    ImportError: navfilter.sensors has moved: import navfilter.models.sensors.
    """
    new = dict(pair.split() for pair in _MOVED.split(",")).get(name.removeprefix(_PACKAGE))
    if name.startswith(_PACKAGE) and new is not None:
        raise ImportError(f"{name} has moved: import {_PACKAGE}{new}.", name=name)
