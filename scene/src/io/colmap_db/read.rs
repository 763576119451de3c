//! Reading a database that may lie about its contents.

use super::{Database, DatabaseImage, ImagePair, pair_of};
use crate::io::colmap_bin::{check_camera, insert};
use crate::io::{IoError, safe_name};
use crate::{CameraModel, Features, Keypoint, Pose, TwoViewGeometry, TwoViewKind};
use glam::{DMat3, DQuat, DVec3};
use rusqlite::types::ValueRef;
use rusqlite::{Connection, OpenFlags, Row};
use std::io::Read;
use std::path::Path;

/// Reads COLMAP's database, version 3.8 to 4.2. Every count is checked against the bytes that are
/// there, every number of an image, camera or feature against what it refers to; the message names
/// file and table.
pub fn read_database(path: &Path) -> Result<Database, IoError> {
    let source = DatabaseSource { path, connection: open(path)? };
    let mut database = Database::default();
    source.cameras(&mut database)?;
    source.images(&mut database)?;
    source.keypoints(&mut database)?;
    source.descriptors(&mut database)?;
    source.matches(&mut database)?;
    source.geometries(&mut database)?;
    Ok(database)
}

/// Opens without writing: a database that was closed well needs no log beside it.
fn open(path: &Path) -> Result<Connection, IoError> {
    let mut head = [0; 16];
    let mut file = std::fs::File::open(path).map_err(IoError::file("read", path))?;
    let whole = file.read_exact(&mut head).is_ok();
    if !whole || &head != b"SQLite format 3\0" {
        return Err(IoError::format(path, "expected a COLMAP database (SQLite), found something else"));
    }
    let absolute = std::path::absolute(path).map_err(IoError::file("read", path))?;
    let log = absolute.with_file_name(format!(
        "{}-wal",
        absolute.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
    ));
    let pending = std::fs::metadata(log).is_ok_and(|m| m.len() > 0);
    let escaped: String = absolute.as_os_str().as_encoded_bytes().iter().map(|&b| percent(b)).collect();
    let uri = format!("file:{escaped}?{}", if pending { "mode=ro" } else { "immutable=1" });
    let flags =
        OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_URI | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let failed = |e: rusqlite::Error| IoError::format(path, format!("cannot be opened as a database: {e}"));
    let connection = Connection::open_with_flags(uri, flags).map_err(failed)?;
    connection.execute_batch("PRAGMA trusted_schema = OFF; PRAGMA cell_size_check = ON;").map_err(failed)?;
    Ok(connection)
}

fn percent(byte: u8) -> String {
    if byte.is_ascii_alphanumeric() || b"/-_.~".contains(&byte) {
        char::from(byte).to_string()
    } else {
        format!("%{byte:02X}")
    }
}

struct DatabaseSource<'a> {
    path: &'a Path,
    connection: Connection,
}

impl DatabaseSource<'_> {
    fn error(&self, table: &str, message: impl std::fmt::Display) -> IoError {
        IoError::format(self.path, format!("table {table}: {message}"))
    }

    /// Calls `take` with every row of a real table (a view could go on for ever).
    fn each(
        &self,
        table: &str,
        columns: &str,
        mut take: impl FnMut(&Row) -> Result<(), IoError>,
    ) -> Result<(), IoError> {
        let sql = |e: rusqlite::Error| self.error(table, format!("{e}; the file is damaged"));
        let kind = self.connection.query_row(
            "SELECT type FROM sqlite_master WHERE name = ? AND sql NOT LIKE 'CREATE VIRTUAL%'",
            [table],
            |row| row.get::<_, String>(0),
        );
        match kind {
            Ok(kind) if kind == "table" => {}
            Ok(_) | Err(rusqlite::Error::QueryReturnedNoRows) => {
                return Err(self.error(table, "is missing; this is no database of COLMAP's"));
            }
            Err(e) => return Err(sql(e)),
        }
        let mut statement =
            self.connection.prepare(&format!("SELECT {columns} FROM {table}")).map_err(sql)?;
        let mut rows = statement.query([]).map_err(sql)?;
        while let Some(row) = rows.next().map_err(sql)? {
            take(row)?;
        }
        Ok(())
    }

    fn integer(&self, table: &str, row: &Row, column: &str) -> Result<i64, IoError> {
        match row.get_ref(column) {
            Ok(ValueRef::Integer(i)) => Ok(i),
            _ => Err(self.error(table, format!("{column} is not a whole number; the file is damaged"))),
        }
    }

    fn number(&self, table: &str, row: &Row, column: &str) -> Result<u32, IoError> {
        let i = self.integer(table, row, column)?;
        u32::try_from(i).map_err(|_| self.error(table, format!("{column} is {i}; the file is damaged")))
    }

    /// Bytes; none where the column is NULL.
    fn blob<'r>(&self, table: &str, row: &'r Row, column: &str) -> Result<&'r [u8], IoError> {
        match row.get_ref(column) {
            Ok(ValueRef::Blob(bytes)) => Ok(bytes),
            Ok(ValueRef::Null) => Ok(&[]),
            _ => Err(self.error(table, format!("{column} does not hold bytes; the file is damaged"))),
        }
    }

    /// The bytes of `rows` × `cols` values of `size` bytes, believed only if there are so many, and
    /// `cols`.
    fn array<'r>(
        &self,
        table: &str,
        what: &str,
        row: &'r Row,
        size: usize,
    ) -> Result<(&'r [u8], usize), IoError> {
        let (rows, cols) = (self.integer(table, row, "rows")?, self.integer(table, row, "cols")?);
        let data = self.blob(table, row, "data")?;
        let needed = i128::from(rows) * i128::from(cols) * size as i128;
        if rows < 0 || cols < 0 || needed != data.len() as i128 {
            let message = format!(
                "{what}: {rows} × {cols} values need {needed} bytes, found {}; the file is damaged",
                data.len()
            );
            return Err(self.error(table, message));
        }
        Ok((data, cols as usize))
    }

    fn cameras(&self, database: &mut Database) -> Result<(), IoError> {
        let table = "cameras";
        self.each(table, "camera_id, model, width, height, params, prior_focal_length", |row| {
            let id = self.number(table, row, "camera_id")?;
            let number = self.integer(table, row, "model")?;
            let model = i32::try_from(number).ok().and_then(CameraModel::from_colmap_id);
            let Some(model) = model else {
                let model = format!("number {number}");
                return Err(IoError::UnsupportedCamera { path: self.path.into(), model });
            };
            let size = ["width", "height"].map(|c| self.integer(table, row, c));
            let [width, height] = size;
            let size = [u64::try_from(width?).unwrap_or(0), u64::try_from(height?).unwrap_or(0)];
            let (params, rest) = self.blob(table, row, "params")?.as_chunks::<8>();
            if !rest.is_empty() {
                return Err(self.error(table, format!("camera {id}: params are no doubles")));
            }
            let params = params.iter().map(|b| f64::from_le_bytes(*b)).collect();
            let mut camera = check_camera(self.path, id, model, size, params)?;
            camera.has_prior_focal = self.integer(table, row, "prior_focal_length")? != 0;
            insert(self.path, "camera", &mut database.cameras, id, camera)
        })
    }

    fn images(&self, database: &mut Database) -> Result<(), IoError> {
        let table = "images";
        self.each(table, "image_id, name, camera_id", |row| {
            let id = self.number(table, row, "image_id")?;
            if id == 0 {
                return Err(self.error(table, "image number 0; COLMAP counts from 1"));
            }
            let camera = self.number(table, row, "camera_id")?;
            if !database.cameras.contains_key(&camera) {
                let message = format!("image {id} refers to camera {camera}, which is missing");
                return Err(self.error(table, message));
            }
            let Ok(Ok(name)) = row.get_ref("name").map(|v| v.as_str()) else {
                return Err(self.error(table, format!("image {id} has no name")));
            };
            let name = safe_name(name).map_err(IoError::name(self.path))?.to_owned();
            let image = DatabaseImage { name, camera, features: Features::default() };
            insert(self.path, "image", &mut database.images, id, image)
        })
    }

    /// The image that a row is about.
    fn image<'d>(
        &self,
        table: &str,
        row: &Row,
        database: &'d mut Database,
    ) -> Result<(u32, &'d mut Features), IoError> {
        let id = self.number(table, row, "image_id")?;
        match database.images.get_mut(&id) {
            Some(image) => Ok((id, &mut image.features)),
            None => Err(self.error(table, format!("image {id} is not in the table images"))),
        }
    }

    fn keypoints(&self, database: &mut Database) -> Result<(), IoError> {
        let table = "keypoints";
        self.each(table, "image_id, rows, cols, data", |row| {
            let (id, features) = self.image(table, row, database)?;
            let (data, cols) = self.array(table, &format!("image {id}"), row, 4)?;
            let values: Vec<f32> = data.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
            if values.iter().any(|v| !v.is_finite()) {
                return Err(IoError::not_finite(self.path, format!("table {table}: image {id}: a keypoint")));
            }
            if !values.is_empty() && !matches!(cols, 2 | 4 | 6) {
                let message = format!("image {id}: {cols} numbers a keypoint; 2, 4 or 6 are known");
                return Err(self.error(table, message));
            }
            features.keypoints = values.chunks_exact(cols.max(1)).map(keypoint).collect();
            Ok(())
        })
    }

    fn descriptors(&self, database: &mut Database) -> Result<(), IoError> {
        let table = "descriptors";
        self.each(table, "image_id, rows, cols, data", |row| {
            let (id, features) = self.image(table, row, database)?;
            let (data, cols) = self.array(table, &format!("image {id}"), row, 1)?;
            if data.is_empty() {
                return Ok(());
            }
            if cols != Features::DIM {
                let message = format!("image {id}: descriptors of {cols} bytes; only SIFT's 128 are known");
                return Err(self.error(table, message));
            }
            if data.len() != features.len() * Features::DIM {
                let (rows, n) = (data.len() / Features::DIM, features.len());
                return Err(self.error(table, format!("image {id}: {rows} descriptors for {n} keypoints")));
            }
            features.descriptors = data.to_vec();
            Ok(())
        })
    }

    fn matches(&self, database: &mut Database) -> Result<(), IoError> {
        let table = "matches";
        let mut all = std::mem::take(&mut database.matches);
        self.each(table, "pair_id, rows, cols, data", |row| {
            let (pair, matches) = self.pair(table, row, database)?;
            match all.insert(pair, matches) {
                None => Ok(()),
                Some(_) => Err(self.error(table, format!("{} is there twice", named(pair)))),
            }
        })?;
        database.matches = all;
        Ok(())
    }

    fn geometries(&self, database: &mut Database) -> Result<(), IoError> {
        let table = "two_view_geometries";
        let mut all = std::mem::take(&mut database.geometries);
        self.each(table, "*", |row| {
            let (pair, inliers) = self.pair(table, row, database)?;
            let [f, e, h] = ["F", "E", "H"].map(|column| {
                let values = self.doubles::<9>(table, row, column, pair)?;
                let matrix = values.map(|v| DMat3::from_cols_array(&v).transpose());
                Ok::<_, IoError>(matrix.filter(|m| *m != DMat3::ZERO))
            });
            let pose =
                (self.doubles::<4>(table, row, "qvec", pair)?, self.doubles::<3>(table, row, "tvec", pair)?);
            let b_from_a = match pose {
                (Some([w, x, y, z]), Some(t)) if w * w + x * x + y * y + z * z > 1e-12 => Some(Pose {
                    rotation: DQuat::from_xyzw(x, y, z, w).normalize(),
                    translation: DVec3::from_array(t),
                }),
                _ => None,
            };
            let geometry = TwoViewGeometry {
                a: pair.0 as usize - 1,
                b: pair.1 as usize - 1,
                kind: kind(self.integer(table, row, "config")?),
                inliers,
                f: f?,
                e: e?,
                h: h?,
                b_from_a,
                median_angle: 0.0,
            };
            match all.insert(pair, geometry) {
                None => Ok(()),
                Some(_) => Err(self.error(table, format!("{} is there twice", named(pair)))),
            }
        })?;
        database.geometries = all;
        Ok(())
    }

    /// The pair of a row and its matches; every one names features that are there.
    fn pair(
        &self,
        table: &str,
        row: &Row,
        database: &Database,
    ) -> Result<(ImagePair, Vec<[u32; 2]>), IoError> {
        let number = self.integer(table, row, "pair_id")?;
        let pair = pair_of(number)
            .filter(|(a, b)| database.images.contains_key(a) && database.images.contains_key(b))
            .ok_or_else(|| self.error(table, format!("pair {number} names no two images that are there")))?;
        let (data, cols) = self.array(table, &named(pair), row, 4)?;
        if !data.is_empty() && cols != 2 {
            return Err(self.error(table, format!("{}: {cols} numbers a match, not 2", named(pair))));
        }
        let matches: Vec<[u32; 2]> = data
            .as_chunks::<8>()
            .0
            .iter()
            .map(|m| m.as_chunks::<4>().0)
            .map(|m| [u32::from_le_bytes(m[0]), u32::from_le_bytes(m[1])])
            .collect();
        let counts = [pair.0, pair.1].map(|id| database.images[&id].features.len());
        if let Some(m) = matches.iter().find(|m| m[0] as usize >= counts[0] || m[1] as usize >= counts[1]) {
            let message =
                format!("{}: a match of features {} and {}, of {counts:?}", named(pair), m[0], m[1]);
            return Err(self.error(table, message));
        }
        Ok((pair, matches))
    }

    /// N doubles; `None` where the column is NULL, empty or not there (databases older than 3.8).
    fn doubles<const N: usize>(
        &self,
        table: &str,
        row: &Row,
        column: &str,
        pair: ImagePair,
    ) -> Result<Option<[f64; N]>, IoError> {
        if row.as_ref().column_index(column).is_err() {
            return Ok(None);
        }
        let data = self.blob(table, row, column)?;
        if data.is_empty() {
            return Ok(None);
        }
        let (values, _) = data.as_chunks::<8>();
        if data.len() != 8 * N {
            let message = format!("{}: {column} has {} bytes, not {}", named(pair), data.len(), 8 * N);
            return Err(self.error(table, message));
        }
        let values: [f64; N] = std::array::from_fn(|i| f64::from_le_bytes(values[i]));
        if values.iter().any(|v| !v.is_finite()) {
            return Err(IoError::not_finite(self.path, format!("table {table}: {}: {column}", named(pair))));
        }
        Ok(Some(values))
    }
}

fn named((a, b): ImagePair) -> String {
    format!("images {a} and {b}")
}

/// `x y`, `x y scale angle` or `x y a11 a12 a21 a22`, whose scale is the mean length of the columns
/// and whose angle is that of the first (COLMAP's `FeatureKeypoint`).
fn keypoint(v: &[f32]) -> Keypoint {
    let (scale, angle) = match *v {
        [_, _, scale, angle] => (scale, angle),
        [_, _, a11, a12, a21, a22] => ((a11.hypot(a21) + a12.hypot(a22)) / 2.0, a21.atan2(a11)),
        _ => (1.0, 0.0),
    };
    Keypoint { x: v[0], y: v[1], scale, angle }
}

/// COLMAP's `ConfigurationType`; what it does not take for a geometry is degenerate here.
fn kind(config: i64) -> TwoViewKind {
    match config {
        2 | 9 => TwoViewKind::Calibrated,
        3 => TwoViewKind::Uncalibrated,
        4 | 6 => TwoViewKind::Planar,
        5 => TwoViewKind::Panoramic,
        7 => TwoViewKind::Watermark,
        _ => TwoViewKind::Degenerate,
    }
}
