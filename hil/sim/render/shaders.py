"""GLSL of the fast renderer. Everything is computed in the camera's optical frame."""

from __future__ import annotations

from typing import Any

VISUALS_PER_DRAW = 512
"""Length of the uniform arrays: 5 vec4 = 80 bytes each, below the 64 KiB every driver grants."""

_VISUAL_BLOCK = f"""
struct Visual {{
    vec4 row0, row1, row2;  // X_CV: pose of the shape in the camera frame, by rows
    vec4 color;             // rgb; w = label
    vec4 look;              // x = texture layer or -1
}};
layout(std140) uniform Visuals {{ Visual visuals[{VISUALS_PER_DRAW}]; }};
"""

VERTEX = f"""
#version 330
{_VISUAL_BLOCK}
uniform mat4 projection;
in vec3 in_position;
in vec3 in_normal;
in vec2 in_uv;
in vec4 in_color;
in int in_visual;
out vec3 p_C;
out vec3 normal_C;
out vec3 uvw;
out vec3 albedo;
flat out float label;
void main() {{
    Visual v = visuals[in_visual];
    vec4 p = vec4(in_position, 1.0);
    p_C = vec3(dot(v.row0, p), dot(v.row1, p), dot(v.row2, p));
    normal_C = vec3(dot(v.row0.xyz, in_normal), dot(v.row1.xyz, in_normal), dot(v.row2.xyz, in_normal));
    uvw = vec3(in_uv, v.look.x);
    albedo = v.color.rgb * in_color.rgb;
    label = v.color.w;
    gl_Position = projection * vec4(p_C, 1.0);
}}
"""

FRAGMENT = """
#version 330
uniform vec3 to_light;      // unit
uniform vec3 up;            // world z, in the camera frame
uniform vec3 light;         // colour times strength
uniform vec3 sky;           // ambient light from above
uniform vec3 ground;        // and from below
uniform float specular;
uniform mat4 shadow_from_C; // camera frame -> shadow map 0..1
uniform float shadow_offset;
uniform sampler2DArray skins;
uniform sampler2DShadow shadow_map;
in vec3 p_C;
in vec3 normal_C;
in vec3 uvw;
in vec3 albedo;
flat in float label;
layout(location = 0) out vec4 out_color;
layout(location = 1) out float out_depth;
layout(location = 2) out int out_label;
void main() {
    vec3 to_eye = -normalize(p_C);
    vec3 n = normalize(normal_C);
    if (dot(n, to_eye) < 0.0) n = -n;
    vec3 base = albedo;
    float mark = 0.0;
#ifdef TEXTURED
    vec4 texel = texture(skins, uvw);
    base *= texel.rgb;
    mark = texel.a > 0.5 ? 1.0 : 0.0;
#endif
    base *= base;  // display value -> linear light, gamma 2
    float facing = dot(n, to_light);
    float lit = max(facing, 0.0);
#ifdef SHADOWS
    if (lit > 0.0) {
        vec4 s = shadow_from_C * vec4(p_C + n * shadow_offset, 1.0);
        // Beside the map everything is lit; behind its far end all that it shows casts shadows.
        if (all(greaterThan(s.xy, vec2(0.0))) && all(lessThan(s.xy, vec2(1.0))))
            lit *= texture(shadow_map, vec3(s.xy, min(s.z, 1.0)));
    }
#endif
    vec3 ambient = mix(ground, sky, 0.5 + 0.5 * dot(n, up));
    vec3 half_way = normalize(to_light + to_eye);
    float h = max(dot(n, half_way), 0.0);
    h *= h; h *= h; h *= h; h *= h; h *= h;  // h^32
    vec3 color = base * (ambient + lit * light) + lit * specular * h * light;
    out_color = vec4(sqrt(clamp(color, 0.0, 1.0)), mark);
    out_depth = p_C.z;
    out_label = int(label);
}
"""

SHADOW_VERTEX = f"""
#version 330
{_VISUAL_BLOCK}
uniform mat4 shadow_from_C;
in vec3 in_position;
in int in_visual;
void main() {{
    Visual v = visuals[in_visual];
    vec4 p = vec4(in_position, 1.0);
    vec3 p_C = vec3(dot(v.row0, p), dot(v.row1, p), dot(v.row2, p));
    vec4 s = shadow_from_C * vec4(p_C, 1.0);
    gl_Position = vec4(s.xyz * 2.0 - 1.0, 1.0);
}}
"""

SHADOW_FRAGMENT = """
#version 330
void main() {}
"""

# A triangle that covers the screen at the far plane: fills what nothing else did.
BACKDROP_VERTEX = """
#version 330
void main() {
    vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
    gl_Position = vec4(corner, 1.0, 1.0);
}
"""

BACKDROP_FRAGMENT = """
#version 330
uniform vec3 background;
layout(location = 0) out vec4 out_color;
layout(location = 1) out float out_depth;
layout(location = 2) out int out_label;
void main() {
    out_color = vec4(background, 0.0);
    out_depth = 0.0;
    out_label = -1;
}
"""


def build_programs(ctx: Any) -> dict[str, Any]:
    """Compile everything: "plain", "textured", both also "... shadows", "shadow", "backdrop".

    Variants instead of uniform switches, because llvmpipe evaluates both sides of a branch.
    """

    def build(vertex: str, fragment: str, *defines: str) -> Any:
        head = "#version 330\n" + "".join(f"#define {name}\n" for name in defines)
        sources = (source.strip().replace("#version 330\n", head, 1) for source in (vertex, fragment))
        return ctx.program(*sources)

    return {
        "plain": build(VERTEX, FRAGMENT),
        "textured": build(VERTEX, FRAGMENT, "TEXTURED"),
        "plain shadows": build(VERTEX, FRAGMENT, "SHADOWS"),
        "textured shadows": build(VERTEX, FRAGMENT, "TEXTURED", "SHADOWS"),
        "shadow": build(SHADOW_VERTEX, SHADOW_FRAGMENT),
        "backdrop": build(BACKDROP_VERTEX, BACKDROP_FRAGMENT),
    }
