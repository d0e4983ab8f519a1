//! A task's score runs; one run with the counts of any threshold; making datasets from it.

mod contact;
mod kept;
mod list;
mod make;
mod picture;
mod query;
mod run;

pub(super) use self::{
    kept::{cohort_sheet, cohorts, figures},
    list::show as list,
    make::make,
    query::parameters,
    run::{show, what_if},
};
