//! The largest lab of a kind for which each part suffices.

use crate::{
    demand::{Demand, Part},
    lab::Lab,
    machine::Machine,
};

/// The most robots of this kind of lab for which a part of the machine suffices; 0 if it does not suffice for one.
#[must_use]
pub fn largest_lab(lab: &Lab, machine: &Machine, part: Part) -> u32 {
    let suffices = |robots: u32| {
        let lab = Lab { robots, ..lab.clone() };
        Demand::of(&lab, machine).iter().all(|demand| demand.part != part || demand.share() <= 1.0)
    };
    // Needs grow with the number of robots.
    let (mut least, mut beyond) = (0, u32::MAX);
    while beyond - least > 1 {
        let middle = least + (beyond - least) / 2;
        if suffices(middle) {
            least = middle;
        } else {
            beyond = middle;
        }
    }
    least
}
