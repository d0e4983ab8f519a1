-- Where the newest attempt of a job runs: the engine, its id there, the machine, and the reason for waiting. An attempt on
-- a cluster outlives the server, which finds it again by these.
alter table jobs add column engine text not null default '';
alter table jobs add column engine_id text not null default '';
alter table jobs add column node text not null default '';
alter table jobs add column waiting text not null default '';
-- The one process that may speak for the running attempt: the first that did. Null until then.
alter table jobs add column process text;
