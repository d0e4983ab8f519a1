-- A task's spec is fixed once episodes are read through it, so it is one immutable document.
create table tasks (
    id text primary key,
    name text not null unique,
    spec text not null,              -- JSON of the recording crate's TaskSpec
    created_at integer not null      -- every time here is milliseconds since 1970, UTC
) strict;
