"""The stages of a pipeline as its message. Independent of how it is started."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gleaner import settings
from gleaner._messages import build
from gleaner._proto import kinds
from gleaner.types import PipelineSpec

_JOBS = {
    "pretrain": kinds.PretrainValues,
    "score": kinds.ScoreValues,
    "train": kinds.TrainValues,
    "evaluate": kinds.EvaluateValues,
}
# Every pipeline pretrains.
_ALWAYS = {"snapshot_id", "rule", "pretrain"}


def pipeline_spec(stages: settings.PipelineStages) -> PipelineSpec:
    """The pipeline of these stages. Raises `InvalidArgument` for the name of a stage or setting that does not exist."""
    given: dict[str, Any] = {name: value for name, value in stages.items() if value is not None}
    settings.expect_known("pipeline", given, settings.PipelineStages)
    scores = bool(given.keys() - _ALWAYS)

    def job(name: str) -> dict[str, Any]:
        values: Mapping[str, Any] = given.get(name, {})
        settings.expect_known(f"pipeline.{name}", values, _JOBS[name])
        return {"settings": settings.values(values)}

    return build(
        PipelineSpec,
        {
            "pretrain": {**job("pretrain"), "snapshot_id": given.get("snapshot_id"), "rule": given.get("rule")},
            "score": scores,
            "scoring": job("score") if scores else None,
            "beta": given.get("beta"),
            "top_fraction": given.get("top_fraction"),
            "shape": given.get("shape"),
            "train": job("train") if "train" in given else None,
            "evaluate": job("evaluate") if "evaluate" in given else None,
        },
    )
