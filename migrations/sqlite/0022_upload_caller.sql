-- The client that opened an upload: `token:` and the token's id, `address:` and an address, or `server`. Limits on open
-- uploads count by it, and so does the order of inspections. Clients of earlier uploads are not known; those count for
-- the server, which has no limit.
alter table uploads add column client text not null default 'server';

create index uploads_by_client on uploads (client);
