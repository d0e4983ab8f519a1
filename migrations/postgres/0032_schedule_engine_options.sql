-- Options that the jobs of a schedule pass to their engine, such as those of sbatch.
alter table schedules add column engine_options text collate "C" not null default '';
