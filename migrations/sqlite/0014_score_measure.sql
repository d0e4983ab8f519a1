-- What features are measured in and what similarities are measured against. Runs from before had neither.
alter table score_runs add column feature_scale text not null default 'plain';
alter table score_runs add column yardstick text not null default 'none';

update jobs set spec = json_set(spec, '$.spec.feature_scale', 'plain', '$.spec.yardstick', 'none')
    where kind = 'score' and json_extract(spec, '$.spec.feature_scale') is null;
