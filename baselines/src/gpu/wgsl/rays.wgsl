// Between networks and rays: rows of rays spread over their samples; colours and densities of the
// networks' outputs.

@group(0) @binding(1) var<storage, read> of_rays: array<f32>;
@group(0) @binding(2) var<storage, read> owners: array<u32>;
@group(0) @binding(3) var<storage, read_write> spread_rows: array<f32>;
@group(0) @binding(4) var<storage, read_write> density_rows: array<f32>;
@group(0) @binding(5) var<storage, read_write> colour_rows: array<f32>;
@group(0) @binding(6) var<storage, read_write> shaded: array<vec4f>;

@compute @workgroup_size(256)
fn spread(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let at = (group.y * groups.x + group.x) * 256u + local;
    if (at < job.rows * job.spread_width) {
        let owner = owners[at / job.spread_width];
        spread_rows[at] = of_rays[owner * job.spread_width + at % job.spread_width];
    }
}

// Colour, then density, of each sample.
@compute @workgroup_size(256)
fn shade(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let at = group.x * 256u + local;
    if (at >= job.rows) {
        return;
    }
    let x = density_rows[at * job.density_width + job.density_column];
    let limited = clamp(x, -job.log_density, job.log_density);
    let density = select(max(x, 0.0), exp(limited), job.fast != 0u);
    let c = at * job.colour_width;
    let rgb = vec3f(colour_rows[c], colour_rows[c + 1u], colour_rows[c + 2u]);
    shaded[at] = vec4f(1.0 / (1.0 + exp(-rgb)), density);
}
