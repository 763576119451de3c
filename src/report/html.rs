//! Pieces of HTML, escaped by `maud`.

use anyhow::{Context as _, Result};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use std::path::Path;

/// A longer list is folded. Source: chosen by hand, never measured.
const SHORT_LIST: usize = 3;

/// JSON that cannot end the script it stands in.
pub(crate) fn json(value: &impl serde::Serialize) -> Result<Markup> {
    let text = serde_json::to_string(value)?;
    Ok(PreEscaped(text.replace('<', "\\u003c")))
}

/// The frame of a page: `body` between head and scripts.
pub(crate) fn page(title: &str, body: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                link rel="icon" href="data:,";
                (PreEscaped(GENERATOR))
                title { (title) }
                style { (PreEscaped(include_str!("style.css"))) }
            }
            body {
                (body)
                script { (PreEscaped(include_str!("page.js"))) }
            }
        }
    };
    page.into_string()
}

/// Says in a page who made it.
const GENERATOR: &str = "<meta name=\"generator\" content=\"sat-recon\">";

/// A page is written where nothing is or an older page of ours: any other file stays.
pub(crate) fn refuse_foreign(file: &Path) -> Result<()> {
    let is_page = file.extension().is_some_and(|e| e.eq_ignore_ascii_case("html"));
    anyhow::ensure!(is_page, "{}: the name of a page ends in .html", file.display());
    if file.symlink_metadata().is_ok() {
        let text = std::fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
        let start = String::from_utf8_lossy(&text[..text.len().min(4096)]);
        let ours = start.contains(GENERATOR);
        anyhow::ensure!(ours, "{} is no page of sat-recon's; choose another name", file.display());
    }
    Ok(())
}

/// A bulleted list; nothing for none.
pub(crate) fn list(items: &[String]) -> Markup {
    html! {
        @if !items.is_empty() {
            ul { @for item in items { li { (item) } } }
        }
    }
}

/// A list that is folded where it is long.
pub(crate) fn folded(summary: &str, items: &[String]) -> Markup {
    if items.len() <= SHORT_LIST {
        return list(items);
    }
    html! {
        details {
            summary { (items.len()) " " (summary) }
            (list(items))
        }
    }
}

/// A chart with its caption.
pub(crate) fn figure(svg: String, caption: &str) -> Markup {
    html! {
        figure {
            (PreEscaped(svg))
            figcaption { (caption) }
        }
    }
}

/// A table whose first column is text and the others numbers.
pub(crate) fn table(heads: &[&str], rows: &[Vec<String>]) -> Markup {
    html! {
        div.scroll {
            table {
                tr { @for (i, head) in heads.iter().enumerate() { th.n[i > 0] { (head) } } }
                @for row in rows {
                    tr { @for (i, cell) in row.iter().enumerate() { td.n[i > 0] { (cell) } } }
                }
            }
        }
    }
}

/// A picture inside a page.
pub(crate) struct InlinePicture {
    width: u32,
    height: u32,
    source: String,
}

impl InlinePicture {
    /// The picture of a file, at most `size` pixels wide and high.
    pub(crate) fn read(path: &Path, size: u32) -> Result<Self> {
        let image = scene::io::load_rgb(path)?;
        let small = scene::io::shrunk(&image, size);
        let mut bytes = Vec::new();
        let encoder =
            image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, crate::pictures::JPEG_QUALITY);
        small.write_with_encoder(encoder)?;
        let source = format!("data:image/jpeg;base64,{}", STANDARD.encode(bytes));
        Ok(Self { width: small.width(), height: small.height(), source })
    }

    /// As an element with a class (or none) and a text for those who do not see it.
    pub(crate) fn element(&self, class: Option<&str>, alt: &str) -> Markup {
        html! {
            img class=[class] alt=(alt) width=(self.width) height=(self.height) decoding="async"
                src=(self.source);
        }
    }
}

/// Two pictures over each other with a movable border.
pub(crate) fn slider(left: (&str, &InlinePicture), right: (&str, &InlinePicture), caption: &str) -> Markup {
    html! {
        figure.slider {
            div.pair {
                (left.1.element(None, left.0))
                (right.1.element(Some("over"), right.0))
                i {}
                b { (left.0) }
                b { (right.0) }
            }
            input type="range" min="0" max="100" value="50"
                aria-label={ "border between " (left.0) " and " (right.0) };
            figcaption { (caption) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_from_files_cannot_become_markup() {
        let evil = "<script>alert(\"x\")</script>".to_owned();
        let page = page(&evil, &table(&["a", "b"], &[vec![evil.clone(), evil.clone()]]));
        assert!(!page.contains("<script>alert") && page.contains("&lt;script&gt;alert"), "{page}");
        let json = json(&evil).unwrap().into_string();
        assert!(!json.contains("</script>"), "{json}");
    }

    #[test]
    fn long_lists_are_folded_and_empty_ones_are_nothing() {
        let items = |n: usize| vec!["item".to_owned(); n];
        assert_eq!(list(&[]).into_string(), "");
        assert!(!folded("items", &items(3)).into_string().contains("details"));
        assert!(folded("items", &items(4)).into_string().contains("4 items"));
    }
}
