//! What each step costs.

use crate::StepTime;
use std::time::Instant;

/// Measures laps of wall-clock and processor time.
pub(super) struct Clock {
    wall: Instant,
    cpu: f64,
}

impl Clock {
    pub(crate) fn start() -> Self {
        Self { wall: Instant::now(), cpu: cpu_seconds() }
    }

    /// Notes what has passed since the last lap.
    pub(crate) fn lap(&mut self, step: &str, steps: &mut Vec<StepTime>) {
        let (wall, cpu) = (Instant::now(), cpu_seconds());
        let wall_s = (wall - self.wall).as_secs_f64();
        steps.push(StepTime { step: step.to_owned(), wall_s, cpu_s: cpu - self.cpu });
        (self.wall, self.cpu) = (wall, cpu);
    }
}

/// User and system time of this process, seconds, from `/proc/self/stat` (fields 14 and 15, in
/// hundredths on Linux); 0 elsewhere.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The second field is the program's name in brackets and may hold blanks.
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |i: usize| fields.get(i).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}
