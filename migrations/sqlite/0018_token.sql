-- What lets a caller in. Only the hash of what was handed out is kept. A revoked token's row stays: the audit log
-- names it.
create table tokens (
    id text primary key,
    name text not null,
    role text not null,
    deployments text not null,       -- JSON list; a robot's, empty for other roles
    hash text not null unique,       -- BLAKE3 of the token
    created_at integer not null,
    expires_at integer,              -- null: never
    revoked_at integer,
    last_used_at integer             -- to the minute
) strict;

-- A name is one live token's.
create unique index tokens_by_name on tokens (name) where revoked_at is null and name <> '';
