//! The filter's bounds alone.

use tch::{Device, Tensor};

use super::*;

#[test]
fn bounds_are_below_distances_but_tight_where_rows_are_far_apart() {
    let (points, queries) = (features(1, 200, 100.0), features(2, 50, 100.0));
    for (metric, view) in METRICS.iter().flat_map(|metric| VIEWS.map(move |view| (metric, view))) {
        let corpus = Corpus::new(&[(0, &points)], *metric, TILES[0]);
        let mut sum = Tensor::zeros([50, 208], (tch::Kind::Float, Device::Cpu));
        let buffer = Tensor::zeros([50 * 208], (tch::Kind::Float, Device::Cpu));
        let (mut moved, mut first) = ([0.0; 3], true);
        for (part, moved) in moved.iter_mut().enumerate() {
            // Too few and too narrow for directions.
            let Some(level) = Level::new(&corpus, view, part) else { continue };
            let placed = level.place(&corpus.frame.apply(&queries, part, 0..50));
            *moved = level.moved + placed.moved;
            if level.counts() {
                level.bound((&placed, None), (&corpus, 0), (&mut sum, first), &buffer);
                first = false;
            }
        }
        assert_eq!(first, view == View::Along);
        let bounds = Vec::<f32>::try_from(sum.flatten(0, -1)).unwrap();
        for (query, bounds) in bounds.chunks(208).enumerate().filter(|_| !first) {
            for (point, bound) in bounds[..200].iter().enumerate() {
                let distance = metric.distance(metric.parts((&queries, query), (&points, point)));
                assert!(*bound <= limit(&corpus.relative, moved, distance / corpus.unit));
                assert!(f64::from(*bound) > distance / corpus.unit * 0.999, "{bound} {distance}");
            }
        }
    }
}
