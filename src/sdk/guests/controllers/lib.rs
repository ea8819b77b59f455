//! The engine's own controllers as a component: the same source, so equal parameters and observations give equal commands.

mod native;

use holdpoint_sdk_1::{Bundle, Description, Skill};

struct Controllers;

impl Bundle for Controllers {
    type Params = native::Params;

    fn describe(params: native::Params) -> Result<Description, String> {
        Ok(params.description())
    }

    fn start(_: u64, params: native::Params) -> Result<Box<dyn Skill>, String> {
        Ok(params.start())
    }
}

holdpoint_sdk_1::component!(Controllers);
