//! Calls into openjp2, which is OpenJPEG translated to Rust and delivers its output through callbacks and raw
//! pointers: they need `unsafe`.

#![allow(unsafe_code)]

use std::ffi::c_void;
use std::slice;

use openjp2::openjpeg::{
    OPJ_CLRSPC_GRAY, OPJ_CODEC_J2K, opj_cparameters_t, opj_stream_set_user_data,
    opj_stream_set_write_function, opj_stream_t,
};
use openjp2::{Codec, Stream, opj_image, opj_image_comptparm};

use super::Shape;
use crate::ground::grid::Grid;

/// Number of bytes that the library collects before it delivers them.
const BUFFER: usize = 1 << 16;

/// Encodes one component of signed samples as a codestream, within about `most_bytes`, or losslessly if there
/// is no such limit. `None` if the library fails.
pub fn encode(samples: &Grid<i32>, shape: Shape, most_bytes: Option<usize>) -> Option<Vec<u8>> {
    let precision = u32::from(shape.precision);
    let component = opj_image_comptparm {
        dx: 1,
        dy: 1,
        w: shape.columns,
        h: shape.rows,
        prec: precision,
        bpp: precision,
        sgnd: 1,
        ..opj_image_comptparm::default()
    };
    let mut image = opj_image::create(&[component], OPJ_CLRSPC_GRAY)?;
    (image.x1, image.y1) = (shape.columns, shape.rows);
    if !image.comps_mut()?.first_mut()?.set_data(samples.cells()) {
        return None;
    }
    let mut parameters = opj_cparameters_t {
        numresolution: i32::from(shape.resolutions),
        tcp_numlayers: 1,
        cp_disto_alloc: 1,
        ..opj_cparameters_t::default()
    };
    if let Some(bytes) = most_bytes {
        let raw = samples.cells().len() as f64 * f64::from(precision) / 8.0;
        // 0 and 1 would mean lossless.
        parameters.tcp_rates[0] = (raw / bytes.max(1) as f64).max(1.001) as f32;
    }
    let mut codec = Codec::new_encoder(OPJ_CODEC_J2K)?;
    let set_up = codec.setup_encoder(&mut parameters, &mut image);
    let mut written: Vec<u8> = Vec::new();
    let mut stream = Stream::new_custom(BUFFER, false);
    let handle: *mut opj_stream_t = (&raw mut stream).cast();
    // SAFETY: `handle` points to a `Stream` that lives to the end of this function, which is what these
    // functions cast it back to. The stream calls `append` with the address of `written`, which was declared
    // before the stream and so outlives it, is not moved, and is not used here until the stream is dropped.
    unsafe {
        opj_stream_set_write_function(handle, Some(append));
        opj_stream_set_user_data(handle, (&raw mut written).cast(), None);
    }
    let is_done = set_up == 1
        && codec.start_compress(&mut image, &mut stream) == 1
        && codec.encode(&mut stream) == 1
        && codec.end_compress(&mut stream) == 1;
    drop(stream);
    is_done.then_some(written)
}

/// Receives the library's output.
extern "C" fn append(bytes: *mut c_void, count: usize, written: *mut c_void) -> usize {
    // SAFETY: the library calls this with `count` readable bytes of its buffer, and with the address that
    // `encode` has set: that of a vector that nothing else uses in the meantime.
    let (bytes, written) =
        unsafe { (slice::from_raw_parts(bytes.cast::<u8>(), count), &mut *written.cast::<Vec<u8>>()) };
    written.extend_from_slice(bytes);
    count
}
