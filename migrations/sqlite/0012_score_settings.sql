-- Everything that a run's scores depend on is frozen with it.
alter table score_runs add column scorer text not null default 'ssdf';
alter table score_runs add column modality_scale text;         -- JSON list of three factors; null: 1, 1, 1
alter table score_runs add column extends text references score_runs (id);
alter table score_runs add column quantiles blob not null default x'';  -- f64: w from low to high; empty for minmax
