"""The report: demonstrations, kept segments, results of the policies. Markdown for people, JSON for programs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

import gleaner
from simulator_example import pictures
from simulator_example.agent import EXPERT
from simulator_example.gleaning import WITH, Gleaned
from simulator_example.plan import Plan
from simulator_example.simulator import Simulator


def write(
    client: gleaner.Client,
    plan: Plan,
    env: Simulator,
    gleaned: Gleaned,
    results: Mapping[str, gleaner.Trials],
) -> Path:
    """Writes pictures, report.json and report.md into the folder of the run; returns the path of report.md."""
    found = {
        "plan": {name: str(value) for name, value in asdict(plan).items()},
        "selection": _selection(client, plan, gleaned),
        "demonstrations": _demonstrations(client, plan, env, gleaned),
        "policies": {name: _result(trials) for name, trials in results.items()},
        "made": {"encoder": gleaned.encoder, "score_run": gleaned.run, "dataset": gleaned.dataset.id},
    }
    shown = pictures.strips(client, env, gleaned.policies[WITH], results[WITH], plan.folder)
    shown["quality q along a failed episode of each agent"] = pictures.curves(
        client, gleaned.run, env.imperfect, gleaned.episodes, plan.folder / "q.png"
    )
    (plan.folder / "report.json").write_text(json.dumps(found, indent=2) + "\n")
    path = plan.folder / "report.md"
    path.write_text(_markdown(plan, env, found, shown))
    return path


def _selection(client: gleaner.Client, plan: Plan, gleaned: Gleaned) -> dict[str, float]:
    return {"top_fraction": plan.keep} if plan.keep else {"beta": client.scores.get(gleaned.run).default_beta}


def _demonstrations(client: gleaner.Client, plan: Plan, env: Simulator, gleaned: Gleaned) -> dict[str, dict[str, Any]]:
    counted = client.scores.what_if(gleaned.run, [_selection(client, plan, gleaned)])[0]
    kept = {cohort.cohort: cohort.kept.segments for cohort in counted.cohorts}
    rows = {}
    for agent in (EXPERT, *env.imperfect):
        mine = [episode for episode in gleaned.episodes if episode.cohort == agent.name]
        q = np.concatenate([client.scores.episode(gleaned.run, episode.id).q for episode in mine])
        rows[agent.name] = {
            "spoiled": "" if agent is EXPERT else f"{agent.spoiled} {agent.amount:g}",
            "episodes": len(mine),
            "steps": sum(episode.steps for episode in mine),
            "successes": sum(gleaner.word(episode, "outcome") == "success" for episode in mine),
            "mean_q": float(q.mean()),
            "kept": kept.get(agent.name, 0),
        }
    return rows


def _result(trials: gleaner.Trials) -> dict[str, Any]:
    low, high = trials.interval
    return {
        "policy": trials.policy_id,
        "episodes": trials.episodes,
        "successes": trials.successes,
        "success_rate": trials.success_rate,
        "low": low,
        "high": high,
        "mean_steps": trials.mean_steps,
    }


def _markdown(plan: Plan, env: Simulator, found: dict[str, Any], shown: Mapping[str, Path]) -> str:
    chosen = found["selection"]
    kept = f"the best {plan.keep:g} of them" if plan.keep else f"those whose q is above {chosen['beta']:g}"
    lines = [
        f"# {plan.task}",
        "",
        f"{plan.simulator} at {env.rate_hz:g} Hz, two cameras of {plan.size} × {plan.size}; {plan.train_steps} steps "
        f"of {plan.train_batch} segments for each policy; of the imperfect segments {kept}, seed {plan.seed}.",
        "",
        "| demonstrations by | episodes | steps | solved | mean q | kept |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for agent, row in found["demonstrations"].items():
        name = f"{agent} ({row['spoiled']})" if row["spoiled"] else agent
        demonstrated = (name, row["episodes"], row["steps"], row["successes"], f"{row['mean_q']:.2f}", row["kept"])
        lines.append(f"| {' | '.join(map(str, demonstrated))} |")
    lines += [
        "",
        "| policy trained on | solved | success rate | 95 % interval | mean steps |",
        "|---|---:|---:|---|---:|",
    ]
    for name, row in found["policies"].items():
        solved, interval = f"{row['successes']} of {row['episodes']}", f"{row['low']:.2f} to {row['high']:.2f}"
        cells = (name, solved, f"{row['success_rate']:.2f}", interval, f"{row['mean_steps']:.0f}")
        lines.append(f"| {' | '.join(map(str, cells))} |")
    lines += [
        "",
        "Experts' q leaves their own episode out. Intervals are Wilson's. Both policies met the same episodes.",
        "",
    ]
    for title, path in shown.items():
        lines += [f"![{title}]({path.name})", "", f"{title[0].upper()}{title[1:]}.", ""]
    return "\n".join(lines)
