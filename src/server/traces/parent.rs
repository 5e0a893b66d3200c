//! A trace in the words of W3C's `traceparent`, by which it goes on elsewhere.

use std::collections::HashMap;

use opentelemetry::Context;
use opentelemetry::propagation::TextMapPropagator;
use opentelemetry_sdk::propagation::TraceContextPropagator;

/// The header, and the column.
const TRACEPARENT: &str = "traceparent";

/// The trace that a `traceparent` names; a new one where it names none.
pub(super) fn of(traceparent: Option<&str>) -> Context {
    let headers: HashMap<String, String> = traceparent
        .filter(|told| is_whole(told))
        .map(|told| (TRACEPARENT.to_owned(), told.to_owned()))
        .into_iter()
        .collect();
    TraceContextPropagator::new().extract_with_context(&Context::new(), &headers)
}

/// The digits of a version, a trace, a span and flags. The reader is content with fewer.
fn is_whole(traceparent: &str) -> bool {
    let parts = traceparent.split('-').map(str::len);
    parts.take(4).eq([2, 32, 16, 2])
}

/// What goes on elsewhere of the request that is answered here, if anybody asks for traces.
pub fn current() -> Option<String> {
    let mut headers = HashMap::new();
    TraceContextPropagator::new().inject_context(&Context::current(), &mut headers);
    headers.remove(TRACEPARENT)
}

#[cfg(test)]
mod tests {
    use opentelemetry::trace::TraceContextExt;

    use super::*;

    const TOLD: &str = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01";

    #[test]
    fn a_trace_goes_on_elsewhere_and_nonsense_begins_a_new_one() {
        let _here = of(Some(TOLD)).attach();
        assert_eq!(current().as_deref(), Some(TOLD));
        let nothing = TOLD.replace(|digit: char| digit.is_ascii_hexdigit(), "0");
        let short = &TOLD[..TOLD.len() - 1];
        for nonsense in ["", "00-1-2-3", "../etc/passwd", &nothing, short].map(Some) {
            let context = of(nonsense);
            assert!(!context.span().span_context().is_valid(), "{nonsense:?}");
        }
        assert!(!of(None).span().span_context().is_valid());
    }

    #[test]
    fn where_nobody_asks_for_traces_nothing_goes_on() {
        assert_eq!(current(), None);
    }
}
