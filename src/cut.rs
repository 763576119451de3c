//! What of a splat is kept when it is written, said by flags or by the viewer.

use anyhow::{Context, Result, bail};
use clap::Args;
use glam::DVec3;
use scene::{Gaussians, SplatCut};

/// What of a splat is kept.
#[derive(Args, Clone, Debug, Default, PartialEq)]
pub struct CutConfig {
    /// Only the part of a splat in this box, in the run's units (the viewer shows the numbers)
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = parse_box, allow_hyphen_values = true)]
    pub crop: Option<[f64; 6]>,
    /// Without parts of a splat that hang together with nothing else and hold less than so much of
    /// its opacity, %
    #[arg(long, value_name = "PERCENT", num_args = 0..=1, default_missing_value = "1",
          value_parser = scene::flag::between::<f64>(0.0, 100.0))]
    pub without_floaters: Option<f64>,
}

fn parse_box(text: &str) -> Result<[f64; 6], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    let numbers = numbers.filter(|n| n.iter().all(|v| v.is_finite()));
    numbers.and_then(|n| n.try_into().ok()).ok_or_else(|| "expected six finite numbers".to_owned())
}

impl CutConfig {
    /// As the viewer asks for it: `box=…&floaters=PERCENT`, either may be missing.
    pub(crate) fn of_query(query: &str) -> Result<Self> {
        let mut cut = Self::default();
        for (name, value) in query.split('&').filter_map(|part| part.split_once('=')) {
            match name {
                "box" => cut.crop = Some(parse_box(value).map_err(anyhow::Error::msg)?),
                "floaters" => {
                    let share = value.parse().ok().filter(|v| (0.0..=100.0).contains(v));
                    cut.without_floaters = Some(share.context("floaters: expected 0 to 100")?);
                }
                _ => bail!("{name} is unknown"),
            }
        }
        Ok(cut)
    }

    /// Whether anything is to be cut.
    pub(crate) fn is_some(&self) -> bool {
        *self != Self::default()
    }

    /// Cuts; says how many Gaussians went.
    pub(crate) fn apply(&self, gaussians: &mut Gaussians) -> usize {
        let within = self.crop.map(|c| [DVec3::new(c[0], c[1], c[2]), DVec3::new(c[3], c[4], c[5])]);
        let least_island = self.without_floaters.unwrap_or(0.0) / 100.0;
        let before = gaussians.len();
        let kept = SplatCut { within, least_island, ..SplatCut::default() }.kept(gaussians);
        gaussians.retain(|i| kept[i]);
        before - gaussians.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_viewer_asks_for_what_flags_say_and_nonsense_is_refused() {
        let asked = CutConfig::of_query("box=-1,0,0,1,2.5,3&floaters=2").unwrap();
        let said = CutConfig { crop: Some([-1.0, 0.0, 0.0, 1.0, 2.5, 3.0]), without_floaters: Some(2.0) };
        assert_eq!(asked, said);
        assert!(!CutConfig::of_query("").unwrap().is_some());
        for odd in ["box=1,2,3", "box=a,0,0,0,0,0", "box=nan,0,0,0,0,0", "floaters=-1", "floaters=x", "a=b"] {
            assert!(CutConfig::of_query(odd).is_err(), "{odd}");
        }
    }
}
