-- How often training hides a window's past. Policies from before never did. An attempt that was under way begins anew:
-- its checkpoint is one of other settings.
update jobs set checkpoint = null, checkpoint_step = null
    where kind = 'train' and state in ('queued', 'running') and json_extract(spec, '$.spec.history_dropout') is null;
update jobs set spec = json_set(spec, '$.spec.history_dropout', 0.0)
    where kind = 'train' and json_extract(spec, '$.spec.history_dropout') is null;
