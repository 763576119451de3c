//! A drawing of what was measured, from three sides.

use super::record::MeasureRecord;
use super::table::{name, with_deviation};
use anyhow::Result;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::{ImageFormat, Rgba, RgbaImage};
use scene::geometry::Mesh;
use shape::measure::{SideView, side_views};
use std::fmt::Write as _;

/// Longest side of the object, pixels. Source: chosen by hand, never measured.
const PIXELS: usize = 360;
/// Room for dimension lines around a view, pixels. Source: chosen by hand, never measured.
const MARGIN: usize = 54;
/// A shape is named in a view where it has at least so many pixels. Source: a name covers them.
const NAMED_PIXELS: usize = 250;
/// Of shapes, in order.
const COLORS: [[u8; 3]; 10] = [
    [0x8d, 0xb7, 0xe0],
    [0xf6, 0xb2, 0x6b],
    [0x93, 0xc4, 0x7d],
    [0xe0, 0x8d, 0x8d],
    [0xb4, 0xa7, 0xd6],
    [0xc9, 0xa1, 0x8a],
    [0xea, 0x9f, 0xcf],
    [0xd5, 0xc9, 0x5f],
    [0x76, 0xc7, 0xc0],
    [0xb0, 0xb0, 0x70],
];

/// The drawing as SVG: shapes in their colours with their names, dimensions beside.
pub(super) fn svg(mesh: &Mesh, labels: &[Option<usize>], record: &MeasureRecord) -> Result<String> {
    let views = side_views(mesh, &record.measures.overall, PIXELS);
    let [front, side, top] = &views;
    let places = [[MARGIN, MARGIN], [front.width + 3 * MARGIN, MARGIN], [MARGIN, front.height + 3 * MARGIN]];
    let width = places[1][0] + side.width + MARGIN;
    let height = places[2][1] + top.height + 2 * MARGIN;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
         height=\"{height}\" font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
    );
    for (view, place) in views.iter().zip(places) {
        draw(&mut out, view, place, labels, record)?;
    }
    let _ = writeln!(out, "</svg>");
    Ok(out)
}

/// One view with its dimensions and the names of its shapes.
fn draw(
    out: &mut String,
    view: &SideView,
    [x, y]: [usize; 2],
    labels: &[Option<usize>],
    record: &MeasureRecord,
) -> Result<()> {
    let (w, h) = (view.width, view.height);
    let mut png = std::io::Cursor::new(Vec::new());
    picture(view, labels).write_to(&mut png, ImageFormat::Png)?;
    let data = STANDARD.encode(png.into_inner());
    let _ = writeln!(
        out,
        "<image x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\" href=\"data:image/png;base64,{data}\"/>"
    );
    let [across, up] = view.axes.map(|i| record.measures.overall.sides[i]);
    let unit = record.unit_name();
    let (below, right) = (y + h + 14, x + w + 14);
    dimension(out, [x, below, x + w, below], &format!("{} {unit}", with_deviation(across)), false);
    dimension(out, [right, y, right, y + h], &format!("{} {unit}", with_deviation(up)), true);
    for (label, [cx, cy]) in named(view, labels, record.measures.features.len()) {
        let text = name(&record.measures.features, label);
        let (cx, cy) = (x as f64 + cx, y as f64 + cy + 4.0);
        let _ = writeln!(
            out,
            "<text x=\"{cx:.0}\" y=\"{cy:.0}\" text-anchor=\"middle\" stroke=\"#fff\" stroke-width=\"3\" \
             paint-order=\"stroke\">{text}</text>"
        );
    }
    Ok(())
}

/// A line with ticks and a text beside it.
fn dimension(out: &mut String, [x0, y0, x1, y1]: [usize; 4], text: &str, upright: bool) {
    let (tx, ty) = if upright { (4, 0) } else { (0, 4) };
    let tick = [[x0, y0], [x1, y1]].map(|[x, y]| [x - tx, y - ty, x + tx, y + ty]);
    let lines = [[x0, y0, x1, y1], tick[0], tick[1]];
    let path = lines.map(|[a, b, c, d]| format!("M{a} {b}L{c} {d}"));
    let _ = writeln!(out, "<path d=\"{}\" stroke=\"#333\" fill=\"none\"/>", path.concat());
    let (cx, cy) = ((x0 + x1) / 2, (y0 + y1) / 2);
    let (at, turn) = if upright { ((cx + 16, cy), -90) } else { ((cx, cy + 16), 0) };
    let _ = writeln!(
        out,
        "<text transform=\"translate({} {}) rotate({turn})\" text-anchor=\"middle\">{text}</text>",
        at.0, at.1
    );
}

/// Shapes in their colours, the rest grey, darker where it is aslant.
fn picture(view: &SideView, labels: &[Option<usize>]) -> RgbaImage {
    RgbaImage::from_fn(view.width as u32, view.height as u32, |x, y| {
        match view.pixels[y as usize * view.width + x as usize] {
            None => Rgba([0; 4]),
            Some((cosine, triangle)) => {
                let color = labels[triangle].map_or([0xc8; 3], |i| COLORS[i % COLORS.len()]);
                let [r, g, b] = color.map(|v| (f32::from(v) * (0.45 + 0.55 * cosine)) as u8);
                Rgba([r, g, b, 255])
            }
        }
    })
}

/// The shapes that are seen well, each with the pixel of it that is nearest to the middle of all of
/// its pixels.
fn named(view: &SideView, labels: &[Option<usize>], count: usize) -> Vec<(usize, [f64; 2])> {
    let mut pixels: Vec<Vec<[f64; 2]>> = vec![vec![]; count];
    for (i, pixel) in view.pixels.iter().enumerate() {
        if let Some(label) = pixel.and_then(|(_, triangle)| labels[triangle]) {
            pixels[label].push([(i % view.width) as f64, (i / view.width) as f64]);
        }
    }
    let seen = pixels.into_iter().enumerate().filter(|(_, p)| p.len() >= NAMED_PIXELS);
    let placed = seen.filter_map(|(label, p)| {
        let n = p.len() as f64;
        let middle = [0, 1].map(|k| p.iter().map(|q| q[k]).sum::<f64>() / n);
        let away = |q: &[f64; 2]| (q[0] - middle[0]).hypot(q[1] - middle[1]);
        Some((label, p.into_iter().min_by(|a, b| away(a).total_cmp(&away(b)))?))
    });
    placed.collect()
}
