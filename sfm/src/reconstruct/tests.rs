use super::steps::matching::STRONG_TIE;
use super::*;
use scene::Frame;

#[test]
fn one_image_is_an_error_and_black_images_are_no_model() {
    let one =
        FrameSet { frames: vec![Frame { width: 64, height: 64, ..Frame::default() }], ..FrameSet::default() };
    let result = reconstruct(&one, &SfmConfig::default(), &Progress::silent());
    assert!(matches!(result, Err(SfmError::TooFewImages { found: 1, .. })));
    let folder = std::env::temp_dir().join(format!("sat-recon-black-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("black.png");
    image::RgbImage::new(64, 64).save(&path).unwrap();
    let frame = |name: &str| Frame {
        name: name.into(),
        path: path.clone(),
        width: 64,
        height: 64,
        ..Frame::default()
    };
    let black = FrameSet { frames: vec![frame("a.png"), frame("b.png")], ..FrameSet::default() };
    let result = reconstruct(&black, &SfmConfig::default(), &Progress::silent()).unwrap();
    assert!(result.reconstruction.is_none() && result.reason.contains("features"), "{}", result.reason);
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn fewer_features_are_tied_by_fewer_matches_and_more_by_no_more() {
    use crate::sift::{Doubling, SiftConfig};
    let tie =
        |max_features, doubling| strong_tie(&SiftConfig { max_features, doubling, ..SiftConfig::default() });
    assert_eq!(strong_tie(&SiftConfig::default()), STRONG_TIE);
    assert_eq!(tie(8192, Doubling::Auto), STRONG_TIE);
    assert_eq!(tie(2048, Doubling::Auto), STRONG_TIE / 2);
    assert_eq!(tie(2048, Doubling::Never), STRONG_TIE / 4);
}
