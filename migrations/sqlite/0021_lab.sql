-- What ties this database to the folder of its blobs. The stamp beside the blobs repeats `folder` and `generation`: the
-- generation grows with every start, recording, label and deletion, so a database behind its stamp is an older copy.
create table lab (
    id integer primary key check (id = 1),
    folder text not null,                  -- random name of the folder
    stamped integer not null default 0,    -- 1: the stamp was written, so a folder without one is another folder
    generation integer not null default 0,
    episodes integer not null default 0,   -- rows of `episodes`; another number there is a mixture of two copies
    elapsed_ms integer not null default 0, -- time that this database has seen pass, jumps of the clock left out
    seen_at integer                        -- the clock when that was looked at last
) strict;
insert into lab (id, folder, episodes, seen_at) values (
    1,
    lower(hex(randomblob(16))),
    (select count(*) from episodes),
    (select max(at) from (
        select max(created_at) as at from episodes union all select max(created_at) from labels
        union all select max(created_at) from jobs union all select max(at) from audit
    ))
);

create trigger episode_counted after insert on episodes begin
    update lab set episodes = episodes + 1;
end;
create trigger episode_uncounted after delete on episodes begin
    update lab set episodes = episodes - 1;
end;

-- Jumps of the clock: time that the clock says has passed and the database has not seen. Files and rows are removed by
-- age only after the jumps within that age are taken off.
create table clock_jumps (
    elapsed_ms integer not null,           -- `lab.elapsed_ms` at the jump
    jump_ms integer not null
) strict;

-- Rows whose description beside the blobs (the sidecar) is missing or out of date.
create table sidecar_queue (
    seq integer primary key autoincrement, -- another one at each change: what is written is taken out by it
    id text not null unique                -- of a task, an episode, an encoder or a policy
) strict;

insert into sidecar_queue (id) select id from tasks;
insert into sidecar_queue (id) select id from episodes where purged_at is null;
insert into sidecar_queue (id) select id from encoders;
insert into sidecar_queue (id) select id from policies;

create trigger task_described after insert on tasks begin
    insert or replace into sidecar_queue (id) values (new.id);
end;
create trigger episode_described after insert on episodes begin
    insert or replace into sidecar_queue (id) values (new.id);
end;
create trigger episode_changed after update of outcome, cohort, deleted_at, purged_at on episodes begin
    insert or replace into sidecar_queue (id) values (new.id);
end;
create trigger encoder_described after insert on encoders begin
    insert or replace into sidecar_queue (id) values (new.id);
end;
create trigger policy_described after insert on policies begin
    insert or replace into sidecar_queue (id) values (new.id);
end;
