-- The settings of a score run are data, as those of jobs are: one JSON object in place of a column each. The names inside
-- are read in their old form too. An attempt under way begins anew: its checkpoint repeats its settings in the old form.
alter table score_runs add column settings text not null default '{}';

update score_runs set settings = json_object(
    'scorer', scorer, 'similarity', similarity, 'feature_scale', feature_scale, 'yardstick', yardstick,
    'normaliser', normaliser, 'modality_scale', json(coalesce(modality_scale, 'null')));

alter table score_runs drop column scorer;
alter table score_runs drop column similarity;
alter table score_runs drop column feature_scale;
alter table score_runs drop column yardstick;
alter table score_runs drop column normaliser;
alter table score_runs drop column modality_scale;

update jobs set checkpoint = null, checkpoint_step = null where state in ('queued', 'running');
