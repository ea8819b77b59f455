//! Times the engine comparison's episode and prints one JSON line like the peers' scripts.
//!
//! Usage: `peer_episode [EPISODES] [full|adaptive|single|reduced]`; single thread, thread CPU time.
#![expect(clippy::print_stdout, reason = "its output is its purpose")]

use holdpoint_sim::Fidelity;
use holdpoint_sim::bench_episode::{PeerBench, STEPS};
use rustix::time::{ClockId, clock_gettime};

fn cpu_secs() -> f64 {
    let t = clock_gettime(ClockId::ThreadCPUTime);
    t.tv_sec as f64 + 1e-9 * t.tv_nsec as f64
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let episodes: u64 = args.next().map_or(Ok(100), |text| text.parse())?;
    let mode = args.next().unwrap_or_else(|| "full".to_owned());
    let fidelity = match mode.as_str() {
        "full" => Fidelity::Full,
        "adaptive" => Fidelity::Adaptive,
        "single" => Fidelity::Single,
        "reduced" => Fidelity::Reduced,
        other => return Err(format!("mode \"{other}\"; full, adaptive, single or reduced").into()),
    };
    let bench = PeerBench::new(fidelity)?;
    bench.run(episodes)?; // warm-up, as the peers do
    let (mut lifted, mut placed, mut iterations, mut worst) = (0_u32, 0_u32, 0, 0.0_f64);
    let mut times_ms = Vec::new();
    let begin = cpu_secs();
    for seed in 0..episodes {
        let before = cpu_secs();
        let outcome = bench.run(seed)?;
        times_ms.push(1e3 * (cpu_secs() - before));
        lifted += u32::from(outcome.lifted);
        placed += u32::from(outcome.placed);
        iterations += outcome.ik_iterations;
        worst = worst.max(outcome.place_error_m);
    }
    let cpu = cpu_secs() - begin;
    times_ms.sort_by(f64::total_cmp);
    let n = episodes.max(1) as f64;
    let at = |share: usize| times_ms.get(times_ms.len() * share / 10).copied().unwrap_or(f64::NAN);
    println!(
        "{{\"peer\": \"holdpoint-sim\", \"mode\": \"{mode}\", \"precision\": \"f32\", \"episodes\": {episodes}, \"lift_rate\": {:.3}, \"place_rate\": {:.3}, \"episodes_per_cpu_s\": {:.2}, \"cpu_ms_per_ep_best\": {:.3}, \"cpu_ms_per_ep_p10\": {:.3}, \"cpu_ms_per_ep_median\": {:.3}, \"us_per_step_median\": {:.2}, \"ik_iters_per_call\": {:.2}, \"place_error_max_mm\": {:.2}, \"cpu_s\": {cpu:.3}}}",
        f64::from(lifted) / n,
        f64::from(placed) / n,
        n / cpu,
        at(0),
        at(1),
        at(5),
        at(5) * 1e3 / f64::from(STEPS),
        iterations as f64 / (n * f64::from(STEPS)),
        worst * 1e3,
    );
    Ok(())
}
