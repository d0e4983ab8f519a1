//! The filter's bounds alone.

use tch::{Device, Tensor};

use super::*;

#[test]
fn bounds_are_below_distances_but_tight_where_rows_are_far_apart() {
    let (corpus, queries) = (features(1, 200, 100.0), features(2, 50, 100.0));
    for (metric, view) in METRICS.iter().flat_map(|metric| VIEWS.map(move |view| (metric, view))) {
        let frame = Frame::new(&corpus, metric.kind);
        let mut sum = Tensor::zeros([50, 208], (tch::Kind::Float, Device::Cpu));
        let buffer = Tensor::zeros([50 * 208], (tch::Kind::Float, Device::Cpu));
        let (mut moved, mut first) = ([0.0; 3], true);
        for (part, moved) in moved.iter_mut().enumerate() {
            let framed = |features| frame.apply(features, part, (0, Points::count(features)));
            // Too few and too narrow for directions.
            let Some(level) = Level::new(&framed(&corpus), view, (metric, part)) else { continue };
            let placed = level.place(&framed(&queries));
            *moved = level.moved + placed.moved;
            if level.counts() {
                level.bound((&placed, None), 0, (&mut sum, first), (metric, &buffer));
                first = false;
            }
        }
        assert_eq!(first, view == View::Along);
        let bounds = Vec::<f32>::try_from(sum.flatten(0, -1)).unwrap();
        for (query, bounds) in bounds.chunks(208).enumerate().filter(|_| !first) {
            for (point, bound) in bounds[..200].iter().enumerate() {
                let distance = metric.distance(metric.parts((&queries, query), (&corpus, point)));
                assert!(*bound <= limit(metric, moved, distance));
                assert!(f64::from(*bound) > distance * 0.999, "{bound} {distance}");
            }
        }
    }
}
