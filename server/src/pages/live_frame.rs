//! The camera images of running sessions, in a format for browsers.

use bytes::Bytes;
use gleaner_recording::{PictureSizes, PixelFormat, decode_color, encode_jpeg};

use crate::{
    domain::{
        id::SessionId,
        observation::{Image, ImageFormat},
    },
    error::{Error, Result},
    service::Services,
};

/// Good enough to see the robot's motion.
const QUALITY: u8 = 80;

/// The last image of a session's camera as it was sent, a raw one as a step shows it, and its content type.
///
/// # Errors
/// NotFound, naming the missing session or camera; Invalid when a raw image does not have the size of its camera.
pub(super) async fn read(services: &Services, session: &SessionId, camera: &str) -> Result<(&'static str, Bytes)> {
    let (session, state) = services.policies.live_session(session)?;
    let missing = || Error::not_found("camera of this session", camera.escape_debug());
    let seen = state.cameras.into_iter().find(|seen| seen.camera == camera).and_then(|seen| seen.color);
    let image = seen.ok_or_else(missing)?;
    let task = services.store.task_by_id(&session.task_id).await?;
    let spec = task.spec.cameras.iter().find(|spec| spec.name == camera).ok_or_else(missing)?;
    encoded(image, spec.sizes()).await
}

async fn encoded(image: Image, sizes: PictureSizes) -> Result<(&'static str, Bytes)> {
    match image.format {
        ImageFormat::Jpeg => Ok(("image/jpeg", image.data)),
        ImageFormat::Png => Ok(("image/png", image.data)),
        ImageFormat::Any if image.data.starts_with(&[0x89, b'P', b'N', b'G']) => Ok(("image/png", image.data)),
        ImageFormat::Any => Ok(("image/jpeg", image.data)),
        ImageFormat::Raw => {
            let doing = "encoding a session's image";
            let encode = move || {
                let pixels = decode_color(&image.data, PixelFormat::Rgb8, &sizes)?;
                encode_jpeg(&pixels, sizes.height, sizes.width, QUALITY)
            };
            let encoded = tokio::task::spawn_blocking(encode)
                .await
                .map_err(|error| Error::internal(doing, error))?
                .map_err(|error| Error::invalid("camera", error))?;
            Ok(("image/jpeg", encoded.into()))
        }
    }
}
