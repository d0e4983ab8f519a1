-- Options that a job passes to its engine, such as those of sbatch.
alter table jobs add column engine_options text collate "C" not null default '';
