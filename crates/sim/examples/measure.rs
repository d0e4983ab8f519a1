//! Measures the simulator: success of every agent at each grade of both tasks, length of attempts, pictures and
//! attempts a second.
//!
//! `cargo run -p gleaner-sim --example measure -- [attempts per agent]`
#![expect(clippy::print_stdout, reason = "the output of an example")]

use std::io::Cursor;
use std::time::Instant;

use gleaner_sim::{AgentKind, AgentSpec, Sim, SimConfig, SimError, Task, demonstrate};

fn main() -> Result<(), SimError> {
    let attempts: u64 = std::env::args().nth(1).and_then(|text| text.parse().ok()).unwrap_or(500);
    for task in Task::ALL {
        println!("{task:<18}   success   steps  mark (share of the attempt)   mean departure from the mark on");
        for kind in AgentKind::ALL {
            let grades: &[f64] = if kind == AgentKind::Expert { &[0.0] } else { &[0.3, 0.5, 0.7, 1.0] };
            for &grade in grades {
                success(task, AgentSpec::new(kind, grade)?, attempts);
            }
        }
    }
    for size in [32, 64, 128] {
        speed(size)?;
    }
    Ok(())
}

fn success(task: Task, agent: AgentSpec, attempts: u64) {
    let config = SimConfig { image: 8, ..SimConfig::default() };
    let (mut successes, mut steps, mut marked, mut mark) = (0.0, 0.0, 0.0, 0.0);
    let mut departures = Vec::new();
    for seed in 0..attempts {
        let demonstration = demonstrate(task, config, agent, seed);
        successes += f64::from(u8::from(demonstration.success));
        steps += demonstration.steps() as f64;
        if let Some(step) = demonstration.went_wrong {
            marked += 1.0;
            mark += f64::from(step) / demonstration.steps() as f64;
            departures.extend(demonstration.departure.into_iter().skip(step as usize).map(f64::from));
        }
    }
    let n = attempts as f64;
    let mark = if marked > 0.0 {
        let departure = departures.iter().sum::<f64>() / departures.len() as f64;
        format!("{:.2} in {:>3.0} %                 {departure:.2}", mark / marked, 100.0 * marked / n)
    } else {
        "none".to_owned()
    };
    println!("{:<18} {:>7.1} % {:>6.1}  {mark}", agent.to_string(), 100.0 * successes / n, steps / n);
}

fn speed(size: u32) -> Result<(), SimError> {
    let config = SimConfig { image: size, ..SimConfig::default() };
    let sim = Sim::new(Task::PickCube, config, 1);
    let (start, mut frames) = (Instant::now(), 0.0);
    while start.elapsed().as_secs_f64() < 1.0 {
        std::hint::black_box(sim.observe());
        frames += 2.0;
    }
    let frames_s = frames / start.elapsed().as_secs_f64();
    let (start, mut attempts) = (Instant::now(), 0);
    while start.elapsed().as_secs_f64() < 1.0 {
        let demonstration = demonstrate(Task::PickCube, config, AgentSpec::EXPERT, attempts);
        std::hint::black_box(demonstration.write_mcap(Cursor::new(Vec::new()))?);
        attempts += 1;
    }
    let attempts_s = attempts as f64 / start.elapsed().as_secs_f64();
    println!("{size}x{size}: {frames_s:.0} pictures/s, {attempts_s:.0} expert attempts recorded/s, one core");
    Ok(())
}
