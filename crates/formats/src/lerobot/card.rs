//! The card of a dataset: what the Hub shows, and what each column of gleaner's is.

use std::fmt::Write as _;

use gleaner_core::snapshot::Role;

use super::Totals;
use super::features::Features;
use crate::export::Export;
use crate::piece::Piece;

const HEAD: &str = "---
license: other
task_categories:
- robotics
tags:
- LeRobot
- gleaner
configs:
- config_name: default
  data_files: data/*/*.parquet
---

";

const COLUMNS: &str = "
| column | meaning |
|---|---|
| `gleaner.q` | quality of the segment that ends at the frame, from 0 to 1; 1 for experts |
| `gleaner.w` | similarity to the nearest expert, on which q rests; 0 for experts |
| `gleaner.weight` | weight in training: q of a kept frame, 1 for experts, 0 for a frame that is not kept |
| `gleaner.match_episode`, `gleaner.match_step` | nearest expert: its `episode_index` and `frame_index`; -1 without a match |
| `gleaner.step` | number of the frame in its recording |
| `next.done`, `next.success` | last frame of the episode; last frame of a whole episode that succeeded |

`meta/episodes` has the origin of each episode: `gleaner.episode`, `gleaner.source` (file name), `gleaner.role` (expert or
imperfect), `gleaner.outcome`, `gleaner.cohort` and `gleaner.first_step`.
";

const USE: &str = "
LeRobot's policies do not look at these columns. A loop of your own can draw frames by weight:

```python
sampler = torch.utils.data.WeightedRandomSampler(dataset.hf_dataset[\"gleaner.weight\"], len(dataset))
```
";

/// The text of the card.
pub(super) fn card<E: Export>(export: &E, features: &Features, totals: &Totals) -> String {
    let task = export.task();
    let experts = export.pieces().iter().filter(|piece| piece.role() == Role::Expert).count();
    let mut imperfect = export.pieces().iter().filter(|piece| piece.role() == Role::Imperfect);
    let whole = experts < totals.episodes && imperfect.all(Piece::is_whole);
    let mut card = HEAD.to_owned();
    // Writing into a string does not fail.
    let _ = writeln!(
        card,
        "# {}\n\nA LeRobot dataset v3.0 that gleaner wrote: {experts} expert episodes, whole, and {} {}; {} frames at {} Hz.",
        task.name,
        totals.episodes - experts,
        if whole { "imperfect ones, whole" } else { "kept stretches of imperfect ones, each an episode of its own" },
        totals.frames,
        features.fps(),
    );
    if (f64::from(features.fps()) - task.rate_hz).abs() > 1e-9 {
        let _ = writeln!(
            card,
            "\nThe task has {} Hz. LeRobot's rate is an integer, so `timestamp` counts {} frames a second.",
            task.rate_hz,
            features.fps()
        );
    }
    for (name, value) in export.origin() {
        let _ = writeln!(card, "- {name}: `{value}`");
    }
    card + COLUMNS + USE
}
