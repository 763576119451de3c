//! The file formats: COLMAP models, `transforms.json`, splats.
