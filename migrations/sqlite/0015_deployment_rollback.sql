-- What a change took the place of, so that rolling back twice goes two back. Null: nothing was before.
alter table deployment_changes add column previous integer references deployment_changes (id);

update deployment_changes as change set previous =
    (select max(earlier.id) from deployment_changes earlier where earlier.name = change.name and earlier.id < change.id);
