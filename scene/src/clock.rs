//! Time spent, in seconds.
//!
//! ```
//! use scene::clock::LimitClock;
//!
//! let (wall, processor) = (LimitClock::Wall.seconds(), LimitClock::Processor.seconds());
//! std::thread::sleep(std::time::Duration::from_millis(200));
//! assert!(LimitClock::Wall.seconds() - wall >= 0.2);
//! assert!(LimitClock::Processor.seconds() - processor < 0.1);
//! ```

use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};
use std::str::FromStr;
use std::sync::OnceLock;
use std::time::Instant;

/// What a time limit counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LimitClock {
    /// Wall time.
    #[default]
    Wall,
    /// Processor time of all threads divided by their number, so that what else the machine does
    /// takes nothing away: for comparisons (of no use on a graphics card).
    Processor,
}

impl FromStr for LimitClock {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "wall" => Ok(Self::Wall),
            "processor" => Ok(Self::Processor),
            _ => Err("wall or processor".into()),
        }
    }
}

impl LimitClock {
    /// How they are named.
    pub const NAMES: [&'static str; 2] = ["wall", "processor"];

    /// Seconds since some moment.
    pub fn seconds(self) -> f64 {
        match self {
            Self::Wall => wall_seconds(),
            Self::Processor => cpu_seconds() / rayon::current_num_threads().max(1) as f64,
        }
    }
}

/// Wall time since the first call.
pub fn wall_seconds() -> f64 {
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed().as_secs_f64()
}

/// User and system time of all threads of this process, those that have ended among them.
pub fn cpu_seconds() -> f64 {
    let spent = clock_gettime(ClockId::ProcessCPUTime);
    spent.tv_sec as f64 + spent.tv_nsec as f64 * 1e-9
}
