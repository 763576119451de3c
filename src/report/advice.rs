//! What helps where a light is not green.

use crate::record::{Level, Light};

/// What to do about a light, in a sentence; nothing where it is green or nothing helps.
pub(crate) fn advice(light: &Light) -> Option<&'static str> {
    if !matches!(light.level, Level::Fair | Level::Bad) {
        return None;
    }
    Some(match light.what.as_str() {
        "frames with a pose" => {
            "Film again: more slowly, all the way round, each part in several frames, with more light; \
             or cut the object out (--masks, --key)."
        }
        "loop" if light.level == Level::Bad => {
            "Compare the frames that are named: are they the same side? Something distinct on or around \
             the object tells its sides apart."
        }
        "loop" => "Film the missing side too, unless it is not wanted.",
        "reprojection error" => {
            "Check that only the camera or only the object moved, and that the lens kept its zoom."
        }
        "probability that the model is right" => {
            "Compare the poses in report.html with how it was filmed before you use them."
        }
        "weak frames" => "Trust these poses less; more frames beside them, or more light, would hold them.",
        "held-out views" => "Look at eval/ for what differs; --quality best trains longer.",
        "overfitting" => "More photos help, above all between those far apart.",
        "floaters" => "Check mattes.png; better masks (--masks, --key) keep the splat inside the object.",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_light_that_can_be_red_has_an_advice_and_a_green_one_has_none() {
        let source = include_str!("verdict.rs");
        let named: Vec<&str> =
            source.split("light(\"").skip(1).filter_map(|rest| rest.split('"').next()).collect();
        assert!(named.len() > 6, "{named:?}");
        for what in named {
            let light = |level| Light { what: what.to_owned(), level, reason: String::new() };
            assert!(advice(&light(Level::Bad)).is_some(), "{what}");
            assert!(advice(&light(Level::Good)).is_none(), "{what}");
        }
    }
}
