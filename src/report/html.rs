//! Pieces of HTML.

use anyhow::Result;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use std::fmt::Write as _;
use std::path::Path;

/// Text that may come from file names, made safe for HTML.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// JSON that cannot end the script it stands in.
pub fn json(value: &impl serde::Serialize) -> Result<String> {
    Ok(serde_json::to_string(value)?.replace("</", "<\\/").replace("<!--", "<\\u0021--"))
}

/// The frame of a page: `body` between head and scripts.
pub fn page(title: &str, body: &str) -> String {
    format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"><link rel=\"icon\" href=\"data:,\">\
         <title>{}</title><style>{}</style><body>{body}<script>{}</script></body></html>",
        escape(title),
        include_str!("style.css"),
        include_str!("page.js")
    )
}

/// A bulleted list of HTML items; nothing for none.
pub fn list(html: &mut String, items: impl Iterator<Item = String>) {
    let items: Vec<String> = items.map(|i| format!("<li>{i}</li>")).collect();
    if !items.is_empty() {
        *html += &format!("<ul>{}</ul>", items.concat());
    }
}

/// A list that is folded away where it is long.
pub fn folded(html: &mut String, summary: &str, items: &[String]) {
    if items.len() <= 3 {
        return list(html, items.iter().cloned());
    }
    let _ = write!(html, "<details><summary>{} {summary}</summary>", items.len()); // writing to a string
    list(html, items.iter().cloned());
    html.push_str("</details>");
}

/// A chart with its caption.
pub fn figure(html: &mut String, svg: &str, caption: &str) {
    *html += &format!("<figure>{svg}<figcaption>{}</figcaption></figure>", escape(caption));
}

/// A table whose first column is text and the others numbers; cells are HTML.
pub fn table(html: &mut String, heads: &[&str], rows: &[Vec<String>]) {
    html.push_str("<div class=\"scroll\"><table><tr>");
    for (i, head) in heads.iter().enumerate() {
        *html += &format!("<th{}>{}", if i > 0 { " class=n" } else { "" }, escape(head));
    }
    html.push_str("</tr>");
    for row in rows {
        html.push_str("<tr>");
        for (i, cell) in row.iter().enumerate() {
            *html += &format!("<td{}>{cell}", if i > 0 { " class=n" } else { "" });
        }
        html.push_str("</tr>");
    }
    html.push_str("</table></div>");
}

/// Attributes of an `img` that holds the picture of a file, at most `size` pixels wide and high.
pub fn picture(path: &Path, size: u32) -> Result<String> {
    let image = scene::io::load_rgb(path)?;
    let (w, h) = image.dimensions();
    let scale = (f64::from(size) / f64::from(w.max(h))).min(1.0);
    let [w, h] = [w, h].map(|v| ((f64::from(v) * scale).round() as u32).max(1));
    let small = scene::io::resize_area(&image, w, h);
    let mut bytes = Vec::new();
    small.write_with_encoder(image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 85))?;
    let code = STANDARD.encode(bytes);
    Ok(format!("width={w} height={h} decoding=async src=\"data:image/jpeg;base64,{code}\""))
}

/// Two pictures over each other with a movable border; both are attributes of an `img`.
pub fn slider(html: &mut String, left: (&str, &str), right: (&str, &str), caption: &str) {
    let [left_name, right_name, caption] = [left.0, right.0, caption].map(escape);
    *html += &format!(
        "<figure class=\"slider\"><div class=\"pair\"><img alt=\"{left_name}\" {}>\
         <img class=\"over\" alt=\"{right_name}\" {}><i></i><b>{left_name}</b><b>{right_name}</b></div>\
         <input type=range min=0 max=100 value=50 aria-label=\"border between {left_name} and {right_name}\">\
         <figcaption>{caption}</figcaption></figure>",
        left.1, right.1
    );
}
