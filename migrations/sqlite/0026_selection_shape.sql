-- A selection may have a shape: JSON of the settings that differ from their defaults; null: none.
alter table datasets add column shape text;
