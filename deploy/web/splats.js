// Drawing: each Gaussian is skinned, moved by the look and splatted in the vertex shader, by gavatar's splatting rule.

const WIDTH = 1024; // of the textures that hold one texel a Gaussian; chunks are whole rows

const VERTEX = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
precision highp sampler2DArray;
precision highp isampler2DArray;
uniform usampler2D u_place;   // x y z scale, 16 bits each
uniform sampler2D u_color;    // r g b, spacing
uniform highp usampler2DArray u_joints;
uniform sampler2DArray u_weights;
uniform sampler2D u_transforms; // three texels a joint
#ifdef LOOK
uniform usampler2D u_part;
uniform isampler2DArray u_basis; // four bases of one channel a layer
uniform sampler2D u_mix;      // a row a part: coefficients by four, then two texels of gains
uniform int u_groups;
#endif
uniform vec3 u_low, u_span;
uniform vec2 u_scale;         // the least, and the span
uniform float u_grow;         // variance gained by each, in square spacings
uniform float u_spacing;
uniform float u_missing;      // variance that finer pixels than those of training lack
uniform mat4 u_view;          // world to camera: x right, y down, z forward
uniform vec4 u_lens;          // fx fy cx cy
uniform vec2 u_size;
uniform vec2 u_depth;         // clip depth = x + y / z
uniform vec4 u_rule;          // LOW_PASS, ALPHA_MIN, FRUSTUM_MARGIN, NEAR
in vec2 a_corner;
in uint a_index;
flat out vec3 v_conic;
flat out vec3 v_color;
out vec2 v_offset;

void main() {
  ivec2 at = ivec2(int(a_index) % ${WIDTH}, int(a_index) / ${WIDTH});
  uvec4 place = texelFetch(u_place, at, 0);
  vec3 point = u_low + u_span * vec3(place.xyz) / 65535.0;
  float scale = u_scale.x + u_scale.y * float(place.w) / 65535.0;
  vec4 color = texelFetch(u_color, at, 0);
#ifdef LOOK
  int part = int(texelFetch(u_part, at, 0).r);
  float moved[7];
  for (int c = 0; c < 7; c++) {
    float sum = 0.0;
    for (int g = 0; g < u_groups; g++) {
      sum += dot(texelFetch(u_mix, ivec2(g, part), 0), vec4(texelFetch(u_basis, ivec3(at, g * 7 + c), 0)));
    }
    moved[c] = sum;
  }
  vec4 gains = texelFetch(u_mix, ivec2(u_groups, part), 0);
  vec4 others = texelFetch(u_mix, ivec2(u_groups + 1, part), 0);
  point += vec3(moved[0], moved[1], moved[2]) * gains.xyz;
  color.rgb = clamp(color.rgb + vec3(moved[3], moved[4], moved[5]) * vec3(gains.w, others.xy), 0.0, 1.0);
  scale = max(scale + moved[6] * others.z, 0.0);
#endif
  vec4 rows[3] = vec4[3](vec4(0), vec4(0), vec4(0));
  for (int s = 0; s < SLOTS; s++) {
    uvec4 joints = texelFetch(u_joints, ivec3(at, s), 0);
    vec4 weights = texelFetch(u_weights, ivec3(at, s), 0);
    for (int k = 0; k < 4; k++) {
      if (weights[k] == 0.0) continue;
      for (int r = 0; r < 3; r++) rows[r] += weights[k] * texelFetch(u_transforms, ivec2(r, int(joints[k])), 0);
    }
  }
  vec4 one = vec4(point, 1.0);
  vec4 seen = u_view * vec4(dot(rows[0], one), dot(rows[1], one), dot(rows[2], one), 1.0);
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0); // nowhere, unless what follows says otherwise
  v_offset = vec2(0.0);
  v_conic = vec3(0.0);
  v_color = color.rgb;
  float z = seen.z;
  if (!(z > u_rule.w)) return;
  float spacing = color.a * u_spacing;
  float variance = scale * scale + u_grow * spacing * spacing + u_missing;
  vec2 slope = seen.xy / z;
  vec2 margin = 0.5 * u_rule.z * u_size;
  vec2 bounded = clamp(slope, -(u_lens.zw + margin) / u_lens.xy, (u_size - u_lens.zw + margin) / u_lens.xy);
  vec3 jx = vec3(u_lens.x / z, 0.0, -u_lens.x * bounded.x / z);
  vec3 jy = vec3(0.0, u_lens.y / z, -u_lens.y * bounded.y / z);
  float xx = variance * dot(jx, jx) + u_rule.x;
  float xy = variance * dot(jx, jy);
  float yy = variance * dot(jy, jy) + u_rule.x;
  float det = xx * yy - xy * xy;
  if (!(det > 0.0)) return;
  v_conic = vec3(yy, -xy, xx) / det;
  vec2 extent = sqrt(2.0 * log(1.0 / u_rule.y) * vec2(xx, yy));
  vec2 center = u_lens.xy * slope + u_lens.zw;
  v_offset = a_corner * extent;
  vec2 pixel = center + v_offset;
  gl_Position = vec4(2.0 * pixel.x / u_size.x - 1.0, 1.0 - 2.0 * pixel.y / u_size.y, u_depth.x + u_depth.y / z, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
uniform vec2 u_alpha; // ALPHA_MIN, ALPHA_MAX
flat in vec3 v_conic;
flat in vec3 v_color;
in vec2 v_offset;
out vec4 color;

void main() {
  vec2 d = v_offset;
  float power = -0.5 * (v_conic.x * d.x * d.x + v_conic.z * d.y * d.y) - v_conic.y * d.x * d.y;
  float alpha = min(u_alpha.y, exp(min(power, 0.0)));
  if (alpha < u_alpha.x) discard;
  color = vec4(v_color * alpha, alpha);
}`;

export class Splats {
  // gl: a WebGL2 context. header: of the avatar. Its textures are filled by `add` and read by `draw`.
  constructor(gl, header) {
    this.gl = gl;
    this.header = header;
    this.slots = header.points.slots / 4;
    this.groups = header.look ? header.look.groups : 0;
    this.height = Math.max(1, Math.ceil(header.points.count / WIDTH));
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (this.height > most) throw new Error(`${header.points.count} Gaussians are more than this device can draw (${most * WIDTH})`);
    this.program = this.build();
    this.at = (name) => (this.places[name] ??= gl.getUniformLocation(this.program, name));
    this.places = {};
    this.textures = {};
    this.make("u_place", gl.RGBA16UI);
    this.make("u_color", gl.RGBA8);
    this.make("u_joints", gl.RGBA8UI, this.slots);
    this.make("u_weights", gl.RGBA8, this.slots);
    this.make("u_transforms", gl.RGBA32F, 0, 3, header.joints.parents.length);
    if (this.groups) {
      this.make("u_part", gl.R8UI);
      this.make("u_basis", gl.RGBA8I, this.groups * 7);
      this.make("u_mix", gl.RGBA32F, 0, this.groups + 2, header.look.parts);
    }
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    const corners = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, corners);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
    const corner = gl.getAttribLocation(this.program, "a_corner");
    gl.enableVertexAttribArray(corner);
    gl.vertexAttribPointer(corner, 2, gl.FLOAT, false, 0, 0);
    this.order = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    const index = gl.getAttribLocation(this.program, "a_index");
    gl.enableVertexAttribArray(index);
    gl.vertexAttribIPointer(index, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(index, 1);
    gl.bindVertexArray(null);
    this.drawn = 0;
  }

  build() {
    const { gl } = this;
    const head = `#version 300 es\n#define SLOTS ${this.slots}\n${this.groups ? "#define LOOK\n" : ""}`;
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source.replace("#version 300 es\n", head));
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
        throw new Error(`the browser refuses a shader: ${gl.getShaderInfoLog(shader)}`);
      }
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(`the browser refuses the shaders: ${gl.getProgramInfoLog(program)}`);
    }
    return program;
  }

  make(name, format, layers = 0, width = WIDTH, height = this.height) {
    const { gl } = this;
    const target = layers ? gl.TEXTURE_2D_ARRAY : gl.TEXTURE_2D;
    const texture = gl.createTexture();
    gl.bindTexture(target, texture);
    if (layers) gl.texStorage3D(target, 1, format, width, height, layers);
    else gl.texStorage2D(target, 1, format, width, height);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(target, filter, gl.NEAREST);
    gl.bindTexture(target, null);
    this.textures[name] = { texture, target };
  }

  fill(name, x, y, layer, width, height, format, type, data) {
    const { gl } = this;
    const { texture, target } = this.textures[name];
    gl.bindTexture(target, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, false); // as another library of the page may have left them
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
    if (target === gl.TEXTURE_2D_ARRAY) gl.texSubImage3D(target, 0, x, y, layer, width, height, 1, format, type, data);
    else gl.texSubImage2D(target, 0, x, y, width, height, format, type, data);
    gl.bindTexture(target, null);
  }

  // One chunk of Gaussians, whose arrays fill whole rows of the textures.
  add(chunk) {
    const { gl } = this;
    const y = chunk.start / WIDTH, rows = chunk.padded / WIDTH;
    const put = (name, layer, format, type, data) => this.fill(name, 0, y, layer, WIDTH, rows, format, type, data);
    put("u_place", 0, gl.RGBA_INTEGER, gl.UNSIGNED_SHORT, chunk.place);
    put("u_color", 0, gl.RGBA, gl.UNSIGNED_BYTE, chunk.color);
    for (let s = 0; s < this.slots; s++) {
      const layer = 4 * chunk.padded;
      put("u_joints", s, gl.RGBA_INTEGER, gl.UNSIGNED_BYTE, chunk.joints.subarray(s * layer, (s + 1) * layer));
      put("u_weights", s, gl.RGBA, gl.UNSIGNED_BYTE, chunk.weights.subarray(s * layer, (s + 1) * layer));
    }
    if (!this.groups) return;
    put("u_part", 0, gl.RED_INTEGER, gl.UNSIGNED_BYTE, chunk.part);
    for (let layer = 0; layer < 7 * this.groups; layer++) {
      const size = 4 * chunk.padded;
      put("u_basis", layer, gl.RGBA_INTEGER, gl.BYTE, chunk.basis.subarray(layer * size, (layer + 1) * size));
    }
  }

  // transforms: 12 numbers a joint. coefficients: of the look, or null.
  pose(transforms, coefficients) {
    const { gl } = this;
    this.fill("u_transforms", 0, 0, 0, 3, transforms.length / 12, gl.RGBA, gl.FLOAT, transforms);
    if (!this.groups || !coefficients) return;
    const { parts } = this.header.look, row = 4 * (this.groups + 2);
    const mix = new Float32Array(parts * row);
    for (let p = 0; p < parts; p++) {
      mix.set(coefficients.subarray(p * 4 * this.groups, (p + 1) * 4 * this.groups), p * row);
      mix.set(this.header.look.arrays.gains.subarray(8 * p, 8 * p + 8), p * row + 4 * this.groups);
    }
    this.fill("u_mix", 0, 0, 0, this.groups + 2, parts, gl.RGBA, gl.FLOAT, mix);
  }

  // The order of drawing, far to near, of the first `count` of an array of numbers of Gaussians.
  arrange(order, count) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.bufferData(gl.ARRAY_BUFFER, order, gl.DYNAMIC_DRAW, 0, count);
    gl.bindBuffer(gl.ARRAY_BUFFER, null);
    this.drawn = count;
  }

  // camera: see `Avatar.render`. grow, missing: variances that Gaussians gain. Blends over what the target holds, by
  // premultiplied alpha, and behind what its depth buffer says is nearer.
  draw(camera, grow, missing) {
    const { gl, header, at } = this, { points, rule } = header;
    if (!this.drawn) return;
    gl.useProgram(this.program);
    Object.keys(this.textures).forEach((name, unit) => {
      const { texture, target } = this.textures[name];
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(target, texture);
      gl.bindSampler(unit, null);
      gl.uniform1i(at(name), unit);
    });
    const v = camera.view; // rows
    gl.uniformMatrix4fv(at("u_view"), false, [
      v[0], v[4], v[8], 0, v[1], v[5], v[9], 0, v[2], v[6], v[10], 0, v[3], v[7], v[11], 1,
    ]);
    gl.uniform4f(at("u_lens"), camera.fx, camera.fy, camera.cx, camera.cy);
    gl.uniform2f(at("u_size"), camera.width, camera.height);
    gl.uniform2fv(at("u_depth"), camera.depth ?? [1, -2 * rule.near]); // of a far plane at infinity
    gl.uniform3fv(at("u_low"), points.low);
    gl.uniform3fv(at("u_span"), points.span);
    gl.uniform2fv(at("u_scale"), points.scale);
    gl.uniform1f(at("u_spacing"), points.spacing);
    gl.uniform1f(at("u_grow"), grow);
    gl.uniform1f(at("u_missing"), missing);
    gl.uniform4f(at("u_rule"), rule.low_pass, rule.alpha_min, rule.frustum_margin, rule.near);
    gl.uniform2f(at("u_alpha"), rule.alpha_min, rule.alpha_max);
    if (this.groups) gl.uniform1i(at("u_groups"), this.groups);
    gl.disable(gl.CULL_FACE);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.depthMask(false);
    gl.enable(gl.BLEND);
    gl.blendEquation(gl.FUNC_ADD);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.bindVertexArray(this.array);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.drawn);
    gl.bindVertexArray(null);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
    gl.activeTexture(gl.TEXTURE0);
  }

  close() {
    const { gl } = this;
    for (const { texture } of Object.values(this.textures)) gl.deleteTexture(texture);
    gl.deleteBuffer(this.order);
    gl.deleteVertexArray(this.array);
    gl.deleteProgram(this.program);
  }
}
