"""The `twin` command: the road from a world to a validated log, and its parts.

    twin run WORLD.toml        the whole road
    twin plan WORLD.toml       only the plan; also for a problem.json or a MovingAI map
    twin radio WORLD.toml      only the radio map
    twin suggest WORLD.toml    where to hang access points, with a proof
    twin check WORLD.toml      what is wrong or unwise with it
    twin import MAP            a world from a ROS or MovingAI map
    twin study STUDY.toml      many runs of many variants, summed up
    twin compare A B           two studies side by side
    twin schema                what a world file may say, for editors
    twin validate RUN.mcap     check a log, trusting nothing but the file
    twin info RUN.mcap         what a log holds
    twin report RUN.mcap       a run as one HTML page
    twin export SOURCE         a world's tracks, a run's orders, for other tools
    twin render RUN.mcap       a run as a film, as frames, or as a still
    twin live WORLD.toml       a run in Foxglove while it is made
    twin replay RUN.mcap       a log in Foxglove as if it happened now
    twin diff A.mcap B.mcap    what changed from one run to another

Exit codes: 0 done; 1 done, but the answer is no (no plan, invalid log); 2 bad input (a log that is
cut off, too); 130 stopped by Ctrl-C. Results go to stdout, refusals and progress to stderr.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin.cli_check import check
from twin.cli_compare import compare
from twin.cli_console import DONE, NO, Meter, guarded, print_json, stderr, stdout
from twin.cli_diff import diff
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
from twin.cli_export import export
from twin.cli_import import import_world
from twin.cli_limits import (
    Gap,
    Iterations,
    MethodOption,
    Nodes,
    TimeLimit,
    interruptible,
    solver_params,
)
from twin.cli_live import live, replay
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
    ExecutionPolicy,
    LogFile,
    Method,
    Overwrite,
    Replanning,
    Seed,
    Set,
    WorldFile,
    parse_objective,
    parse_overrides,
    require_suffix,
    require_world,
    run_overrides,
)
from twin.cli_radio import radio
from twin.cli_render import render
from twin.cli_report import report
from twin.cli_schema import schema
from twin.cli_study import study
from twin.cli_suggest import suggest
from twin.cli_validate import ValidateCommand, validate
from twin.errors import TwinError
from worlds.formats import PASSABLE

if TYPE_CHECKING:
    from planner.problem import Problem
    from twin.instance import Stopwatch

app = typer.Typer(
    help="Will my robot fleet keep moving and stay connected? Plan it, run it, check it.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Objective = Annotated[
    str | None,
    typer.Option(
        metavar="hp|tp|snr|C_T,C_H",
        help="hp: fewest handovers first; tp: shortest time first; snr: the best AP everywhere; "
        "or the costs of a slot and a handover.",
    ),
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
    time_limit: TimeLimit = None,
    gap: Gap = None,
    nodes: Nodes = None,
    policy: ExecutionPolicy = None,
    replan: Replanning = None,
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

        require_world(world)
        folder = output or Path("runs") / world.stem
        overrides = _overrides(settings, objective) | run_overrides(policy, replan)
        check_run_folder(RunFiles(folder), overwrite=overwrite)
        with Meter() as meter:
            watch = _stopwatch(meter)
            instance = open_instance(world, overrides=overrides, seed=seed, watch=watch)
            params = solver_params(
                method,
                instance.world.plan.seed,
                iterations=iterations,
                time_limit=time_limit,
                gap=gap,
                nodes=nodes,
            )
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
    time_limit: TimeLimit = None,
    gap: Gap = None,
    nodes: Nodes = None,
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
            params = solver_params(
                method,
                plan_seed,
                iterations=iterations,
                time_limit=time_limit,
                gap=gap,
                nodes=nodes,
            )
            with interruptible() as interrupted:
                answer = make_plan(problem, params, watch=watch, stop=interrupted)
            picture = draw_prices(prices, problem, answer, hall, watch)
            why = explanation(problem, answer, plan_seed, watch) if explain else None
        if output is not None:
            write_text(output, dump_plan(answer))
        if interrupted():
            stderr().print("interrupted: this is the best answer so far", soft_wrap=True)
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


app.command(cls=ValidateCommand)(validate)
app.command()(diff)
app.command()(report)
app.command()(render)
app.command()(live)
app.command()(replay)
app.command()(export)
app.command()(radio)
app.command()(suggest)
app.command()(check)
app.command("import")(import_world)
app.command()(schema)
app.command()(study)
app.command()(compare)


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


def _stopwatch(meter: Meter) -> Stopwatch:
    """A stopwatch that shows its phases."""
    from twin.instance import Stopwatch

    return Stopwatch(meter.step)


def _announce_compilation(meter: Meter) -> None:
    """The first plan on a machine takes seconds longer; say why."""
    from planner.warm_up import kernels_are_compiled

    if meter.visible and not kernels_are_compiled():
        meter.say("compiling the search kernels, once per machine")


def main() -> None:
    """Entry point of the `twin` command."""
    app(prog_name="twin")


if __name__ == "__main__":
    main()
