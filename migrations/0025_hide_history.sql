-- A deployment may hide the history from its policy.
alter table deployment_changes add column hide_history integer not null default 0;
