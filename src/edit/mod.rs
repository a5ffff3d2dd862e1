//! Operations on finished streams: groups are copied from one stream to another, and recoded only where
//! necessary.

pub mod cat;
pub mod cut;
pub mod recover;
pub mod resume;

mod copier;
mod recode;

pub use cat::{Joined, cat};
pub use copier::Named;
pub use cut::{Cut, cut, cut_indexed};
pub use recover::{Recovered, recover, repair};
pub use resume::{PartialFiles, confirm_complete, encode_resuming};
