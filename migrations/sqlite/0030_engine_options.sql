-- Options that a job passes to its engine, such as those of sbatch.
alter table jobs add column engine_options text not null default '';
