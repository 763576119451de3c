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
