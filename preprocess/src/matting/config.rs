use crate::PreprocessError;
use serde::{Deserialize, Serialize};

/// What stands behind the object in the images that are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Background {
    /// Black: the foreground is multiplied by its matte.
    Black,
    /// An alpha channel; the colour under it is that of the foreground alone.
    Transparent,
    /// The filmed background; only edges and spill on the object are cleaned.
    #[default]
    Keep,
}

const DEFAULT_KEY: &str = "auto";

/// How the object is cut out of a green (blue, …) screen.
#[derive(clap::Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct KeyConfig {
    /// Colour of the screen: `auto` finds it and does nothing where there is none; `black` keys a
    /// dark room by light, if one thing alone is lit.
    #[arg(long, value_name = "auto|green|blue|black|#rrggbb|off", default_value = DEFAULT_KEY, help_heading = "Matte")]
    pub key: String,
    /// What stands behind the object in the images that are written.
    #[arg(long, value_enum, default_value_t, help_heading = "Matte")]
    pub background: Background,
    /// Keep what stands still before the screen (the pole that holds the object).
    #[arg(long, help_heading = "Matte")]
    pub keep_pole: bool,
}

impl Default for KeyConfig {
    fn default() -> Self {
        Self { key: DEFAULT_KEY.to_owned(), background: Background::default(), keep_pole: false }
    }
}

/// What `--key` asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum KeyChoice {
    /// Find out.
    Auto,
    /// A screen whose hue lies in this range, degrees.
    Hue(f32, f32),
    /// Dark background.
    Black,
    /// No keying.
    Off,
}

impl KeyChoice {
    /// Whether a screen may have this hue, degrees.
    pub(crate) fn allows(self, hue: f32) -> bool {
        match self {
            Self::Hue(low, high) => (hue - low).rem_euclid(360.0) <= high - low,
            _ => true,
        }
    }
}

impl KeyConfig {
    /// The defaults with another `--key`.
    pub fn with_key(key: &str) -> Self {
        Self { key: key.to_owned(), ..Self::default() }
    }

    /// Reads the text of `--key`.
    pub(crate) fn choice(&self) -> Result<KeyChoice, PreprocessError> {
        match self.key.as_str() {
            "auto" => Ok(KeyChoice::Auto),
            "green" => Ok(KeyChoice::Hue(70.0, 175.0)),
            "blue" => Ok(KeyChoice::Hue(185.0, 270.0)),
            "black" => Ok(KeyChoice::Black),
            "off" => Ok(KeyChoice::Off),
            text => hex(text).ok_or_else(|| {
                PreprocessError::Config(format!(
                    "--key {text} is none of auto, green, blue, black, #rrggbb, off"
                ))
            }),
        }
    }
}

fn hex(text: &str) -> Option<KeyChoice> {
    let digits = text.strip_prefix('#').filter(|d| d.len() == 6)?;
    let value = u32::from_str_radix(digits, 16).ok()?;
    let rgb = [value >> 16, value >> 8, value].map(|v| (v & 255) as u8);
    let (hue, saturation, _) = crate::matting::colour::hue_saturation_value(rgb);
    Some(if saturation < 0.15 { KeyChoice::Black } else { KeyChoice::Hue(hue - 20.0, hue + 20.0) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_read_and_nonsense_is_refused() {
        let choice = |key: &str| KeyConfig { key: key.to_owned(), ..KeyConfig::default() }.choice();
        assert_eq!(choice("auto").unwrap(), KeyChoice::Auto);
        assert_eq!(choice("#00ff00").unwrap(), KeyChoice::Hue(100.0, 140.0));
        assert_eq!(choice("#0a0a0a").unwrap(), KeyChoice::Black);
        for bad in ["", "gren", "#12", "#gggggg", "#ééé"] {
            assert!(choice(bad).is_err(), "{bad}");
        }
    }
}
