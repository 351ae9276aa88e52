"""The `twin` command: the road from a world to a validated log, and its parts.

    twin run WORLD.toml        the whole road
    twin plan WORLD.toml       only the plan; also for a problem.json or a MovingAI map
    twin radio WORLD.toml      only the radio map
    twin check WORLD.toml      what is wrong or unwise with it
    twin import MAP            a world from a ROS or MovingAI map
    twin schema                what a world file may say, for editors
    twin validate RUN.mcap     check a log, trusting nothing but the file
    twin info RUN.mcap         what a log holds

Exit codes: 0 done; 1 done, but the answer is no (no plan, invalid log); 2 bad input (a log that is
cut off, too); 130 stopped by Ctrl-C. Results go to stdout, refusals and progress to stderr.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin.cli_check import check
from twin.cli_console import DONE, NO, Meter, guarded, print_json, refuse, stdout
from twin.cli_explain import (
    NO_PRICES,
    Explain,
    Hall,
    PricesFile,
    check_prices,
    draw_prices,
    explanation,
    print_explanation,
)
from twin.cli_import import import_world
from twin.cli_movingai import (
    Agents,
    Horizon,
    Passable,
    Scenario,
    beyond_sentence,
    beyond_values,
    is_map,
    map_problem,
    refuse_map_options,
)
from twin.cli_options import (
    AsJson,
    Debug,
    LogFile,
    Method,
    Overwrite,
    Seed,
    Set,
    WorldFile,
    parse_objective,
    parse_overrides,
    require_suffix,
)
from twin.cli_schema import schema
from twin.cli_validate import ValidateCommand
from twin.errors import TwinError
from worlds.formats import PASSABLE

if TYPE_CHECKING:
    from planner.problem import Problem
    from planner.solve import SolveParams
    from twin.instance import Stopwatch

app = typer.Typer(
    help="Will my robot fleet keep moving and stay connected? Plan it, run it, check it.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

MethodOption = Annotated[
    Method,
    typer.Option(
        help="auto: as good as it gets, with a proof; pgcp: the paper's algorithm; "
        "cooperative: cooperative A* alone, fast and without a proof; "
        "decoupled: shortest motions first, then the best APs for them."
    ),
]
Objective = Annotated[
    str | None,
    typer.Option(
        metavar="hp|tp|snr|C_T,C_H",
        help="hp: fewest handovers first; tp: shortest time first; snr: the best AP everywhere; "
        "or the costs of a slot and a handover.",
    ),
]
Iterations = Annotated[
    int | None,
    typer.Option(min=1, help="Stop improving after so many iterations (same result every time)."),
]


def _version(wanted: bool) -> None:
    """Print the version and end."""
    if wanted:
        from importlib.metadata import PackageNotFoundError, version

        try:
            typer.echo(f"twin (mapp-twin) {version('mapp-twin')}")
        except PackageNotFoundError:
            typer.echo("twin (mapp-twin), not installed: run from its source")
        raise typer.Exit(DONE)


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Will my robot fleet keep moving and stay connected? Plan it, run it, check it."""


@app.command()
def run(
    world: WorldFile,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Folder; else runs/<name of the file>."),
    ] = None,
    seed: Seed = None,
    method: MethodOption = Method.auto,
    objective: Objective = None,
    iterations: Iterations = None,
    settings: Set = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Plan a world, execute the plan in the twin, write the log, check it, draw it."""
    with guarded(debug):
        from twin.cli_tables import print_road, road_values
        from twin.instance import open_instance
        from twin.outputs import RunFiles, check_run_folder
        from twin.pipeline import travel

        require_suffix(world, (".toml",), "a world file")
        folder = output or Path("runs") / world.stem
        overrides = _overrides(settings, objective)
        check_run_folder(RunFiles(folder), overwrite=overwrite)
        with Meter() as meter:
            watch = _stopwatch(meter)
            instance = open_instance(world, overrides=overrides, seed=seed, watch=watch)
            params = _params(method, iterations, instance.world.plan.seed)
            _announce_compilation(meter)
            road = travel(instance, folder, params=params, overwrite=overwrite, watch=watch)
        if as_json:
            print_json(road_values(road))
        else:
            print_road(stdout(), road)
        raise typer.Exit(DONE if road.succeeded else NO)


@app.command()
def plan(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="WORLD.toml|problem.json|MAP.map", help="A world, a problem, or a grid map."
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="plan.json", help="Write the plan to this file."),
    ] = None,
    seed: Seed = None,
    method: MethodOption = Method.auto,
    objective: Objective = None,
    iterations: Iterations = None,
    settings: Set = None,
    scen: Scenario = None,
    agents: Agents = None,
    horizon: Horizon = None,
    passable: Passable = PASSABLE,
    prices: PricesFile = None,
    explain: Explain = False,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Plan only: one path per robot, with a proven bound on how much better any plan could be."""
    with guarded(debug):
        from planner.json_files import dump_plan
        from twin.cli_tables import plan_values, print_plan, problem_values
        from twin.outputs import check_file, write_text
        from twin.pipeline import make_plan

        require_suffix(source, (".toml", ".json", ".map"), "a world, a problem or a map")
        mapf = (scen, agents, horizon, passable)
        if not is_map(source):
            refuse_map_options(source, *mapf)
        if output is not None:
            check_file(output, (".json",), overwrite=overwrite)
        check_prices(prices, method.value, overwrite=overwrite)
        hall: Hall | None = None
        with Meter() as meter:
            watch = _stopwatch(meter)
            if is_map(source):
                with watch.phase("problem"):
                    problem = map_problem(source, *mapf, settings=settings, objective=objective)
                    plan_seed = seed or 0
            else:
                problem, plan_seed, hall = _problem(source, settings, objective, seed, watch)
            _announce_compilation(meter)
            answer = make_plan(problem, _params(method, iterations, plan_seed), watch=watch)
            picture = draw_prices(prices, problem, answer, hall, watch)
            why = explanation(problem, answer, plan_seed, watch) if explain else None
        if output is not None:
            write_text(output, dump_plan(answer))
        if as_json:
            values = {"problem": problem_values(problem), "plan": plan_values(answer)}
            if is_map(source):
                values["mapf"] = beyond_values(problem, answer)
            if why is not None:
                values["explanation"] = why.to_dict()
            files = {"file": output, "prices_file": picture}
            print_json(values | {key: str(path) if path else None for key, path in files.items()})
        else:
            print_plan(stdout(), problem, answer, watch.seconds, output)
            if is_map(source):
                stdout().print(beyond_sentence(problem, answer), soft_wrap=True)
            if prices is not None:
                stdout().print(f"prices: {picture or NO_PRICES}", soft_wrap=True)
            if why is not None:
                print_explanation(stdout(), why)
            elif answer.unserved:
                stdout().print("--explain says why, and what would be enough")
        complete = answer.status in {"optimal", "feasible"} and not answer.unserved
        raise typer.Exit(DONE if complete else NO)


@app.command()
def radio(
    world: WorldFile,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="radio.png", help="Draw the map, .png or .svg."),
    ] = None,
    seed: Seed = None,
    settings: Set = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Cast the rays of a world: which AP reaches where, and where are the holes."""
    with guarded(debug):
        from twin.cli_radio import print_radio, radio_values
        from twin.instance import open_radio
        from twin.outputs import check_file, staged

        require_suffix(world, (".toml",), "a world file")
        if output is not None:
            check_file(output, (".png", ".svg"), overwrite=overwrite)
        overrides = parse_overrides(settings)
        with Meter() as meter:
            watch = _stopwatch(meter)
            read, floor, radio_map = open_radio(world, overrides=overrides, seed=seed, watch=watch)
            if output is not None:
                with watch.phase("picture"):
                    from worlds.figures import radio_figure, save

                    with staged(output.parent) as stage:
                        save(radio_figure(read, floor, radio_map), stage / output.name)
        if as_json:
            values = radio_values(read, floor, radio_map)
            print_json(values | {"file": str(output) if output else None})
        else:
            print_radio(stdout(), read, floor, radio_map, output)


@app.command(cls=ValidateCommand)
def validate(
    log: LogFile,
    json_file: Annotated[
        Path | None,
        typer.Option(
            "--json", metavar="[FILE]", help="Write the findings as JSON, without FILE to stdout."
        ),
    ] = None,
    junit: Annotated[
        Path | None,
        typer.Option("--junit", metavar="FILE", help="Write them as JUnit XML, for CI."),
    ] = None,
    overwrite: Overwrite = False,
    debug: Debug = False,
) -> None:
    """Check a log: the file itself, the plan, the run slot by slot, and every key figure."""
    with guarded(debug):
        from logs.validate import validate as check
        from twin.cli_tables import print_report
        from twin.outputs import check_file, write_text

        to_stdout = json_file == Path("-")
        targets = [(junit, ".xml"), (None if to_stdout else json_file, ".json")]
        for path, suffix in targets:
            if path is not None:
                check_file(path, (suffix,), overwrite=overwrite)
        with Meter() as meter:
            meter.phase("validation")
            report = check(log)
        if junit is not None:
            write_text(junit, report.to_junit_xml())
        if json_file is not None and not to_stdout:
            write_text(json_file, json.dumps(report.to_dict(), indent=2) + "\n")
        if to_stdout:
            print_json(report.to_dict())
        else:
            print_report(stdout(), report)
        if any(finding.rule == "container:structure" for finding in report.findings):
            refuse(f"{log}: is cut off or damaged; run the world again")
        raise typer.Exit(DONE if report.valid else NO)


@app.command()
def info(log: LogFile, as_json: AsJson = False, debug: Debug = False) -> None:
    """Say what a log holds: the run, its plan, its key figures, topics and attachments."""
    with guarded(debug):
        from logs.mcap_reader import read
        from twin.cli_info import contents, info_values, print_info

        with Meter() as meter:
            meter.phase("reading")
            found = contents(read(log))
        if as_json:
            print_json(info_values(found))
        else:
            print_info(stdout(), found)


app.command()(check)
app.command("import")(import_world)
app.command()(schema)


def _overrides(settings: list[str] | None, objective: str | None) -> dict[str, object]:
    """Those of --set, and --objective as one more."""
    overrides = parse_overrides(settings)
    if objective is not None:
        overrides["plan.objective"] = parse_objective(objective)
    return overrides


def _problem(
    source: Path,
    settings: list[str] | None,
    objective: str | None,
    seed: int | None,
    watch: Stopwatch,
) -> tuple[Problem, int, Hall | None]:
    """The problem a world or a problem.json poses, the planner's seed, and the world's hall."""
    from planner.json_files import parse_problem, read_problem
    from twin.instance import open_instance

    if source.suffix.lower() == ".toml":
        overrides = _overrides(settings, objective)
        instance = open_instance(source, overrides=overrides, seed=seed, watch=watch)
        return instance.problem, instance.world.plan.seed, (instance.world, instance.floor)
    if settings:
        raise TwinError(f"--set: {source} is a problem; only the values of a world can be set")
    with watch.phase("problem"):
        problem = read_problem(source)
        if objective is not None:
            data = json.loads(source.read_text(encoding="utf-8-sig"))
            data["objective"] = parse_objective(objective)
            problem = parse_problem(json.dumps(data), source.name)
    return problem, seed or 0, None


def _params(method: Method, iterations: int | None, seed: int) -> SolveParams:
    """What the options ask of the planner."""
    from planner.solve import SolveParams

    params = SolveParams(method=method.value, seed=seed)
    return params if iterations is None else replace(params, iterations=iterations)


def _stopwatch(meter: Meter) -> Stopwatch:
    """A stopwatch that shows its phases."""
    from twin.instance import Stopwatch

    return Stopwatch(meter.step)


def _announce_compilation(meter: Meter) -> None:
    """The first plan on a machine takes seconds longer; say why."""
    from twin.pipeline import kernels_are_compiled

    if meter.visible and not kernels_are_compiled():
        meter.say("compiling the search kernels, once per machine")


def main() -> None:
    """Entry point of the `twin` command."""
    app(prog_name="twin")


if __name__ == "__main__":
    main()
