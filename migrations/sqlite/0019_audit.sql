-- Who changed what. Never a token, never what was written: only names and ids.
create table audit (
    id integer primary key,
    at integer not null,
    token_id text,                   -- null: nobody was asked for one
    who text not null,               -- the token's name, or where the caller sits
    peer text not null,              -- the caller's address; empty when unknown
    rpc text not null,
    subjects text not null,          -- JSON list of field=value
    outcome text not null            -- ok, or the status it was refused with
) strict;

create index audit_by_time on audit (at, id);
