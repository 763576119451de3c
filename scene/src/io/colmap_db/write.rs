//! Writing a database.

use super::{Database, DatabaseImage, pair_number};
use crate::io::atomic::write_file_atomic;
use crate::io::{IoError, safe_name};
use crate::{Features, Keypoint, TwoViewGeometry};
use glam::DMat3;
use rusqlite::{Connection, Transaction, params};
use std::path::Path;

/// The tables as COLMAP 3.8 makes them.
const TABLES: &str = "
PRAGMA user_version = 3800;
CREATE TABLE cameras (camera_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, model INTEGER NOT NULL,
    width INTEGER NOT NULL, height INTEGER NOT NULL, params BLOB, prior_focal_length INTEGER NOT NULL);
CREATE TABLE images (image_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, name TEXT NOT NULL UNIQUE,
    camera_id INTEGER NOT NULL, prior_qw REAL, prior_qx REAL, prior_qy REAL, prior_qz REAL,
    prior_tx REAL, prior_ty REAL, prior_tz REAL,
    CONSTRAINT image_id_check CHECK(image_id >= 0 and image_id < 2147483647),
    FOREIGN KEY(camera_id) REFERENCES cameras(camera_id));
CREATE UNIQUE INDEX index_name ON images(name);
CREATE TABLE keypoints (image_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL, cols INTEGER NOT NULL,
    data BLOB, FOREIGN KEY(image_id) REFERENCES images(image_id) ON DELETE CASCADE);
CREATE TABLE descriptors (image_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL, cols INTEGER NOT NULL,
    data BLOB, FOREIGN KEY(image_id) REFERENCES images(image_id) ON DELETE CASCADE);
CREATE TABLE matches (pair_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB);
CREATE TABLE two_view_geometries (pair_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL,
    cols INTEGER NOT NULL, data BLOB, config INTEGER NOT NULL, F BLOB, E BLOB, H BLOB, qvec BLOB, tvec BLOB);
";

/// Writes `database` as a file that COLMAP opens as its own. What stood under the name is replaced
/// only by a whole file. Refused where an image name would lead out of its folder, a camera is
/// missing, or a match names a feature that is not there.
pub fn write_database(path: &Path, database: &Database) -> Result<(), IoError> {
    check(database).map_err(|m| IoError::format(path, format!("refused to write: {m}")))?;
    write_file_atomic(path, |temporary| {
        fill(temporary, database).map_err(|e| std::io::Error::other(format!("SQLite: {e}")))
    })
}

fn check(database: &Database) -> Result<(), String> {
    for (id, image) in &database.images {
        safe_name(&image.name).map_err(|e| e.to_string())?;
        if !database.cameras.contains_key(&image.camera) {
            return Err(format!("image {id} refers to camera {}, which is missing", image.camera));
        }
        if *id == 0 || i64::from(*id) >= super::MAX_IMAGES {
            return Err(format!("{id} is no image number"));
        }
    }
    let inliers = database.geometries.iter().map(|(p, g)| (p, &g.inliers));
    for (&(a, b), matches) in database.matches.iter().chain(inliers) {
        let [rows_a, rows_b] = [a, b].map(|id| database.images.get(&id).map_or(0, |i| i.features.len()));
        if a >= b || matches.iter().any(|&[i, j]| i as usize >= rows_a || j as usize >= rows_b) {
            return Err(format!("a match of images {a} and {b} names a feature that is not there"));
        }
    }
    Ok(())
}

fn fill(path: &Path, database: &Database) -> rusqlite::Result<()> {
    let mut connection = Connection::open(path)?;
    // The file gets its name when it is whole: no journal is needed on the way.
    connection.execute_batch("PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF;")?;
    let transaction = connection.transaction()?;
    transaction.execute_batch(TABLES)?;
    cameras(&transaction, database)?;
    images(&transaction, database)?;
    pairs(&transaction, database)?;
    transaction.commit()?;
    connection.close().map_err(|(_, error)| error)
}

fn cameras(transaction: &Transaction, database: &Database) -> rusqlite::Result<()> {
    let mut insert = transaction.prepare("INSERT INTO cameras VALUES (?, ?, ?, ?, ?, ?)")?;
    for (id, c) in &database.cameras {
        let numbers = doubles(c.params.iter().copied());
        insert.execute(params![id, c.model.colmap_id(), c.width, c.height, numbers, c.has_prior_focal])?;
    }
    Ok(())
}

fn images(transaction: &Transaction, database: &Database) -> rusqlite::Result<()> {
    let mut image = transaction.prepare("INSERT INTO images (image_id, name, camera_id) VALUES (?, ?, ?)")?;
    let mut keypoints = transaction.prepare("INSERT INTO keypoints VALUES (?, ?, 6, ?)")?;
    let mut descriptors = transaction.prepare("INSERT INTO descriptors VALUES (?, ?, 128, ?)")?;
    for (id, DatabaseImage { name, camera, features }) in &database.images {
        image.execute(params![id, name, camera])?;
        let shapes: Vec<u8> = features.keypoints.iter().flat_map(affine).flat_map(f32::to_le_bytes).collect();
        keypoints.execute(params![id, features.len() as i64, shapes])?;
        let count = (features.descriptors.len() / Features::DIM) as i64;
        descriptors.execute(params![id, count, features.descriptors])?;
    }
    Ok(())
}

/// COLMAP's keypoint: x, y and the affine shape `a11 a12 a21 a22`, a rotation times the scale.
fn affine(k: &Keypoint) -> [f32; 6] {
    let (sin, cos) = k.angle.sin_cos();
    [k.x, k.y, k.scale * cos, -k.scale * sin, k.scale * sin, k.scale * cos]
}

fn pairs(transaction: &Transaction, database: &Database) -> rusqlite::Result<()> {
    let mut insert = transaction.prepare("INSERT INTO matches VALUES (?, ?, 2, ?)")?;
    for (&pair, matches) in &database.matches {
        insert.execute(params![pair_number(pair), matches.len() as i64, indices(matches)])?;
    }
    let mut insert =
        transaction.prepare("INSERT INTO two_view_geometries VALUES (?, ?, 2, ?, ?, ?, ?, ?, ?, ?)")?;
    for (&pair, g) in &database.geometries {
        let (qvec, tvec) = relative_pose(g).unzip();
        insert.execute(params![
            pair_number(pair),
            g.inliers.len() as i64,
            indices(&g.inliers),
            g.kind as i32,
            g.f.map(row_major),
            g.e.map(row_major),
            g.h.map(row_major),
            qvec,
            tvec
        ])?;
    }
    Ok(())
}

/// `b_from_a` as w x y z, and t.
fn relative_pose(g: &TwoViewGeometry) -> Option<(Vec<u8>, Vec<u8>)> {
    let pose = g.b_from_a?;
    let (q, t) = (pose.rotation, pose.translation);
    Some((doubles([q.w, q.x, q.y, q.z]), doubles(t.to_array())))
}

fn row_major(m: DMat3) -> Vec<u8> {
    doubles(m.transpose().to_cols_array())
}

fn doubles(values: impl IntoIterator<Item = f64>) -> Vec<u8> {
    values.into_iter().flat_map(f64::to_le_bytes).collect()
}

fn indices(matches: &[[u32; 2]]) -> Vec<u8> {
    matches.iter().flatten().flat_map(|i| i.to_le_bytes()).collect()
}
