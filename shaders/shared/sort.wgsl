// Shared by the kernels that scan and sort: the shape of a block and the parameters of a dispatch.

// Invocations of a workgroup, elements an invocation, and elements of a block.
const WIDTH: u32 = 64;
const ITEMS: u32 = 16;
const BLOCK: u32 = WIDTH * ITEMS;
// Values of an 8-bit digit.
const DIGITS: u32 = 256;
const MAX_WORKGROUPS: u32 = 65535;

struct SortParameters {
    // First bit of the digit.
    shift: u32,
    // Which counter holds the number of elements; FIXED: `capacity` is the number.
    source: u32,
    // Limit of the elements touched.
    capacity: u32,
    // Which counter takes the total of a scan.
    result: u32,
    // The total is cut to this for the indirect arguments.
    result_capacity: u32,
}

const FIXED: u32 = 0xffffffffu;

// `groups` workgroups in rows that every driver accepts; may be a few more than requested.
fn fold_workgroups(groups: u32) -> vec3<u32> {
    let rows = max((groups + MAX_WORKGROUPS - 1u) / MAX_WORKGROUPS, 1u);
    return vec3<u32>((groups + rows - 1u) / rows, rows, 1u);
}
