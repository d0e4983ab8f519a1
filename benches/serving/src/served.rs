//! Gleaner under load: sessions with raw and JPEG images, alternately with the model alone, on an idle machine and beside a
//! training job.

use crate::Result;
use crate::cli::Options;
use crate::connection::Connection;
use crate::in_process::InProcess;
use crate::load::Load;
use crate::prepare::Prepared;
use crate::report::{Bound, Report, Row};
use crate::scene::{Images, observe};
use crate::train::Busy;

/// The largest ratio of the median round trip with one session to the same request in process.
const ROUND_TRIP: f64 = 1.25;
/// The largest time outside the model for one session with raw images, in milliseconds.
const EXTRA: f64 = 0.5;
/// The smallest ratio of the throughputs of 16 sessions and one, and the largest of their 99th percentile and median.
const THROUGHPUT: f64 = 2.0;
const TAIL: f64 = 3.0;

/// Measures every number of sessions, with raw and JPEG images.
pub async fn alone(options: &Options, prepared: &Prepared, model: &mut InProcess, report: &mut Report) -> Result<()> {
    for images in [Images::Raw, Images::Jpeg] {
        let rows = take_turns(options, prepared, model, (images, &options.sessions)).await?;
        let of = |sessions: usize| rows.iter().find(|row| row.sessions == sessions);
        if let Some(one) = of(1) {
            let ratio = one.load.p50 / one.alone;
            report.target(Bound::at_most(&name("round trip p50 / alone, 1 session", images), ROUND_TRIP), ratio);
        }
        if let (Images::Raw, Some(served)) = (images, of(1).and_then(|row| row.load.served.as_ref())) {
            report.target(Bound::at_most("p99 outside the model, ms, raw, 1 session", EXTRA), served.extra_p99);
        }
        if let (Some(one), Some(many)) = (of(1), of(16)) {
            let gain = many.load.actions_per_second / one.load.actions_per_second;
            report.target(Bound::at_least(&name("throughput of 16 sessions / of 1", images), THROUGHPUT), gain);
            let tail = many.load.p99 / many.load.p50;
            report.target(Bound::at_most(&name("p99 / p50, 16 sessions", images), TAIL), tail);
        }
        report.rows.extend(rows);
    }
    Ok(())
}

/// Measures one session with raw images while a training job runs.
pub async fn beside_training(
    options: &Options,
    prepared: &Prepared,
    model: &mut InProcess,
    report: &mut Report,
) -> Result<()> {
    let busy = Busy::begin(&prepared.client, &prepared.spec, prepared.preset).await?;
    let before = busy.done().await?;
    let rows = take_turns(options, prepared, model, (Images::Raw, &[1])).await?;
    let trained = busy.done().await?.saturating_sub(before);
    busy.end().await?;
    if trained == 0 {
        return Err("the concurrent training job took no step, so the load was not measured; increase --seconds".into());
    }
    for mut row in rows {
        row.beside_training = true;
        if let Some(served) = &row.load.served {
            let bound = Bound::at_most("p99 outside the model, ms, raw, 1 session, beside training", EXTRA);
            report.target(bound, served.extra_p99);
        }
        report.rows.push(row);
    }
    Ok(())
}

/// Measures the model alone, then each number of sessions, round after round.
async fn take_turns(
    options: &Options,
    prepared: &Prepared,
    model: &mut InProcess,
    (images, sessions): (Images, &[usize]),
) -> Result<Vec<Row>> {
    let scene = prepared.steps.iter().map(|step| observe(&prepared.spec, step, images)).collect::<Result<Vec<_>>>()?;
    let mut loads = Vec::new();
    for &count in sessions {
        loads.push((Connection::open_many(&prepared.address, count).await?, Load::default()));
    }
    for _ in 0..options.rounds {
        model.add(&prepared.steps, (images, &scene), options.slice() / 2)?;
        for (connections, load) in &mut loads {
            load.add(connections, &scene, options.slice()).await?;
        }
    }
    let alone = model.take_median();
    let row = |(connections, load): (Vec<Connection>, Load)| Row {
        images,
        sessions: connections.len(),
        beside_training: false,
        alone,
        load: load.summary(),
    };
    Ok(loads.into_iter().map(row).collect())
}

fn name(what: &str, images: Images) -> String {
    let images = match images {
        Images::Raw => "raw",
        Images::Jpeg => "JPEG",
    };
    format!("{what}, {images}")
}
