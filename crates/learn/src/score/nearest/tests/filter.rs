//! The filter's bounds by themselves.

use tch::{Device, Tensor};

use super::*;
use crate::batch::values;

#[test]
fn bounds_are_below_distances_but_tight_where_rows_are_far_apart() {
    let (experts, queries) = (features(1, 200, 100.0), features(2, 50, 100.0));
    for (metric, view) in METRICS.iter().flat_map(|metric| VIEWS.map(move |view| (metric, view))) {
        let frame = Frame::new(&experts, metric.kind);
        let mut sum = Tensor::zeros([50, 208], (tch::Kind::Float, Device::Cpu));
        let buffer = Tensor::zeros([50 * 208], (tch::Kind::Float, Device::Cpu));
        let (mut moved, mut first) = ([0.0; 3], true);
        for (modality, moved) in moved.iter_mut().enumerate() {
            let framed = |features| frame.apply(features, modality, (0, Features::count(features)));
            // Too few and too narrow for directions.
            let Some(level) = Level::new(&framed(&experts), view, (metric, modality)) else { continue };
            let placed = level.place(&framed(&queries));
            *moved = level.moved + placed.moved;
            if level.counts() {
                level.bound((&placed, None), 0, (&mut sum, first), (metric, &buffer));
                first = false;
            }
        }
        assert_eq!(first, view == View::Along);
        let bounds = values(&sum);
        for (query, bounds) in bounds.chunks(208).enumerate().filter(|_| !first) {
            for (expert, bound) in bounds[..200].iter().enumerate() {
                let distance = metric.distance(metric.parts((&queries, query), (&experts, expert)));
                assert!(*bound <= bound::limit(metric, moved, distance));
                assert!(f64::from(*bound) > distance * 0.999, "{bound} {distance}");
            }
        }
    }
}
