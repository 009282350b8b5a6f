"""retuner identify: the process behind a recorded response."""

from pathlib import Path

from retuner.adaptive.indexes.days import days_of
from retuner.api import NO_STRETCH, Identification, identify_by_region, identify_record
from retuner.commands.options import RecordOptions, tell
from retuner.commands.recorded.other_cause import contradiction, diagnosed, other_cause, weighed
from retuner.commands.recorded.recorded_loop import (
    controller,
    days_told,
    read_loop,
    require_fitting,
    require_length,
    tell_assumed,
)
from retuner.commands.signatures import IdentifyOptions
from retuner.decision_page.row_values import in_full
from retuner.decision_page.shown_units import chosen_units
from retuner.drivers.recorded.recording import Recording, require_excitation
from retuner.errors import UserError, user_input
from retuner.files import write_whole
from retuner.report.change_of_settings import change_words
from retuner.tuning import tuning_lines
from retuner.verbosity import busy


def identify(options: IdentifyOptions) -> int:
    """Identify and show; the exit status: 0, or 1 when the record does not say enough.

    Raises UserError, RecordingError: the file or an option cannot be used.
    """
    gains = controller(options)
    read = read_loop(options)
    recording = read.recording
    require_excitation(recording)
    require_length(recording)
    require_fitting(recording, gains)
    if options.region_by or options.bounds:
        # identify and show each region by itself; the exit status: 0, or 1 when one of them is not known
        window = recording.window()
        signals = {"pv": window.pv, "sp": window.sp, "co": window.co}
        if options.region_by not in signals or options.plot is not None:
            raise UserError(
                f"--region-by {options.region_by or 'nothing'}: give pv, sp or co, with --bounds, without --plot"
            )
        limits = {"co_min": options.co_min, "co_max": options.co_max}
        with user_input(f"{recording.source}, --bounds {options.bounds}"), busy(f"identifying {recording.source}"):
            try:
                bounds = [float(one) for one in options.bounds.split(",")]
            except ValueError:
                raise ValueError("give numbers with commas between them, as in --bounds 40,70") from None
            by = signals[options.region_by]
            regions = identify_by_region(window, by, bounds, open_loop=options.open_loop, gains=gains, **limits)
        tell_assumed(read.assumed, options)
        document = {"regions": [region.to_dict() for region in regions], "assumed": [a.what for a in read.assumed]}
        lines = list[str]()
        for region in regions:
            title = f"{options.region_by} {region.low:g} to {region.high:g}, {region.samples} samples: "
            first, *rest = [f"NOT identifiable: {NO_STRETCH}"] if region.found is None else described(region.found)
            lines += [title + first, *rest]
        tell(document, lines, as_json=options.as_json)
        return 0 if all(region.found is not None and region.found.estimate.identifiable for region in regions) else 1
    with user_input(recording.source), busy(f"identifying {recording.source}"):
        found = identify_record(
            recording.window(), open_loop=options.open_loop, gains=gains, co_min=options.co_min, co_max=options.co_max
        )
        said, told = None, []  # nothing is diagnosed in manual
        if not options.open_loop:
            known = found.estimate.identifiable
            result = diagnosed([recording.window()], gains, (options.co_min, options.co_max), cause_only=known)
            other = other_cause(result.diagnosis)
            if not known:
                said, told = result.to_dict(), weighed(result)
            elif other is not None:
                said, told = other.to_dict(), contradiction(other)
    if options.plot is not None:
        write_whole(options.plot, _picture(recording, found, options))
    assumed = read.assumed + (() if options.open_loop else days_told(len(days_of(recording.window())), 1))
    tell_assumed(assumed, options)
    more = {"diagnosis": said, "assumed": [a.what for a in assumed]}
    tell(found.to_dict() | more, [*described(found), *told], as_json=options.as_json)
    return 0 if found.estimate.identifiable else 1


def described(found: Identification) -> list[str]:
    """Model, standard deviations and settings in lines."""
    estimate = found.estimate
    # the model with its standard deviations
    model, std = found.estimate.log.model(), found.estimate.log.std()
    lines = [
        "identified" if estimate.identifiable else "NOT identifiable: " + estimate.reason,
        f"  {'type':<6} {model.type:>10}",
        *(
            f"  {name:<6} {in_full(value):>10} +- {in_full(float(f'{std[name]:.2g}'))}{' s' if name != 'k' else ''}"
            for name, value in {"k": model.k, **model.times_s, "theta": model.theta_s}.items()
        ),
        *([f"  {'zeta':<6} {model.zeta:10.4g}"] if model.zeta < 1 else []),
    ]
    if estimate.identifiable:
        lines.append(f"  {estimate.reason}; residual {estimate.residual_std:.3g}, noise {estimate.noise_std:.3g}")
    if estimate.load_times_s:
        lines.append("  load steps at " + ", ".join(f"{t:.4g} s" for t in estimate.load_times_s))
    if found.settings is not None:
        title = "recommended settings:" if found.aim is None else f"recommended first step ({found.step_reason}):"
        lines += [title, *tuning_lines(found.settings, chosen_units())]
    if found.aim is not None:
        lines += ["final settings, once the next record confirms:", *tuning_lines(found.aim, chosen_units())]
    if found.foreseen is not None:
        lines.append(f"with these: {change_words(found.foreseen)}")
    if found.margins_in_force is not None:
        m = found.margins_in_force
        lines.append(
            f"with the active gains: Ms {m.ms:.3f}, GM {m.gm:.3g}, PM {m.pm_deg:.1f} deg"
            if m.stable
            else "with the active gains this loop is UNSTABLE"
        )
    return lines


def _picture(recording: Recording, found: Identification, options: RecordOptions) -> bytes:
    from retuner.adaptive.identification.fitted_curve import fitted_pv
    from retuner.decision_page.svg import drawn
    from retuner.report.record_plots import ExplainedCurve, RecordPicture, record_figure

    estimate = found.estimate
    window = recording.window() if options.open_loop else max(days_of(recording.window()), key=lambda day: len(day.t_s))
    title = f"{Path(recording.source).name}: " + ("identified" if estimate.identifiable else "not identifiable")
    picture = RecordPicture(
        window,
        title,
        estimate.reason,
        described(found)[1:],
        [ExplainedCurve.of("model", window, fitted_pv(window, estimate))],
        estimate.load_times_s,
        (options.co_min, options.co_max),
        estimate.noise_std,
        closed_loop=not options.open_loop,
    )
    assert options.plot is not None
    return drawn(record_figure(picture), title, options.plot.suffix)
