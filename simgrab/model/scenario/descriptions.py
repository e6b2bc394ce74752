"""What every key of a scene file means, by table; the JSON schema and the reference of keys show it.

The unit of a key is the suffix of its name.
"""

from __future__ import annotations

from typing import Any

# By suffix, longest first: what a key's name says of its unit.
_UNITS = {
    "pixels_per_mm": "px/mm",
    "deg_per_m": "°/m",
    "mbit_s": "Mbit/s",
    "m_min": "m/min",
    "m_s2": "m/s²",
    "mm_h": "mm/h",
    "percent": "%",
    "stops": "stops",
    "m_s": "m/s",
    "rpm": "1/min",
    "deg": "°",
    "px": "px",
    "mm": "mm",
    "m2": "m²",
    "m3": "m³",
    "hz": "Hz",
    "ms": "ms",
    "kg": "kg",
    "db": "dB",
    "ev": "stops",
    "m": "m",
    "s": "s",
    "e": "electrons",
}
_TAGS = ("model", "dist")
_VIBRATION = {"vibration": "Random vibration of the camera, added to its tilt."}
_INK = {"ink": "Colours, outline and plate."}
_ROPE = {
    "rope_length_m": "Distance from the rope exit O to the grab centre A.",
    "jaw_deg": "Opening of the jaws: 0 is closed.",
    "load": "Load as a share of a full grab.",
}
_LOOKS = {
    "paint_rgb": "Colour of the paint: red, green and blue from 0 to 1, sRGB.",
    "wear": "Worn paint and rust: 0 is new.",
    "residue": "Cargo that sticks to the grab: 0 is clean.",
    "cargo": "Cargo that the grab holds and that sticks to it.",
}
_ROPES = {"ropes": "Number of ropes that the grab hangs on."}
_SHAPED = _LOOKS | _ROPES | {
    "volume_m3": "What the closed grab holds.",
    "width": "Size across the closing line, relative to the kind's usual proportions; the volume stays.",
    "length": "Size along the closing line, relative to the kind's usual proportions; the volume stays.",
    "height": "Height, relative to the kind's usual proportions; the volume stays.",
    "plate_work": "Ribs and stiffeners on the plates: 0 is smooth.",
    "teeth": "Number of teeth on the cutting edges.",
    "ladder": "Whether a ladder is mounted on the head.",
    "guards": "Whether guard rails stand on the head.",
    "markings": "Whether markings are painted on the grab.",
}  # fmt: skip
_SHELLS = {
    "top": "Whether roofs close the shells from above.",
    "profile": "Shape of the shells' backs, seen along the closing line.",
}
_DRIVE = {"drive": "What closes the jaws."}
_WORN = {"wear": "Age of the place: 0 is new."}
_CARGO = {"cargo": "Bulk cargo in the place."}

_WAVED = {"waves": "Transverse waves of the ropes, for sensors on the rope."}
_PLATE = {"position_m": "Middle of the plate from that of the rope ends, grab frame."}
_CLOCK = {
    "clock_offset_ms": "Standard deviation of the clock's offset, drawn once a clip.",
    "clock_drift_ppm": "Standard deviation of the clock's drift, drawn once a clip.",
}
_READ = {
    "rate_hz": "Readings a second.",
    "resolution_deg": "Size of a count.",
    "zero_error_deg": "Standard deviation of the zero point, drawn once a clip.",
}
_LENGTH = {
    "rate_hz": "Readings a second.",
    "resolution_m": "Size of a count.",
    "zero_error_m": "Standard deviation of the zero point, drawn once a clip.",
    "scale_error": "Standard deviation of the relative scale error, drawn once a clip.",
}
_MOUNTED = {
    "mount": "Where the sensor is: in O, in the camera's housing, on the slewing platform in its axis, on the rope 1 m "
    "below O, or on the grab's head."
}


def _errors_of(sensor: str, noise: str, walk: str, bias: str) -> dict[str, str]:
    each = "for each axis, drawn once a clip."
    unit = bias.partition("_")[2]
    return {
        f"{sensor}_noise_density": f"Density of white noise, {noise}.",
        f"{sensor}_random_walk": f"Random walk of the bias, {walk}.",
        f"{sensor}_{bias}": f"Standard deviation of the bias at turn-on, {each}",
        f"{sensor}_scale_error": f"Standard deviation of the relative scale error, {each}",
        f"{sensor}_misalignment_deg": "Standard deviation by which each axis leans towards each of the other two.",
        f"{sensor}_range_{unit}": "Largest reading; without limit unless given.",
        f"{sensor}_resolution_{unit}": "Size of a count; 0 for none.",
    }


DESCRIPTIONS: dict[str, dict[str, str]] = {
    "Scenario": {
        "base": "Bundled scene that this file departs from.",
        "name": "Name of the scene; the default output folder is runs/NAME.",
        "description": "One sentence on what the scene shows.",
        "seed": "Seed of all random draws.",
        "frames": "Number of frames.",
        "camera": "The surveillance camera at the jib head.",
        "sensors": "Sensors beside the camera, by name; they need physics.",
        "suspension": "How the grab hangs on its ropes.",
        "markers": "What is mounted for a method to look at.",
        "swing": "How the grab swings: independent draws, or physics.",
        "grab": "The grab: its kind, shape and looks.",
        "jib": "The jib head and its ropes.",
        "place": "What lies below the grab.",
        "clutter": "Parked grabs of other cranes.",
        "light": "Sun, sky and floodlights.",
        "optics": "Lens, exposure and sensor effects.",
        "weather": "Fog, rain, snow, dust, wet ground and the cover glass.",
        "image": "How frames are rendered and stored.",
        "shutter": "Exposure time and rolling shutter.",
        "clip": "Frame rate, clips, and video coding.",
        "display": "The on-screen display: clock and rope lengths.",
        "labels": "Which frames get a detection box.",
        "splits": "Shares of train, val and test.",
        "vary": "Keys that are drawn for each clip, each with a distribution or a choice.",
    },
    "Camera": {
        "width_px": "Width of the image.",
        "height_px": "Height of the image.",
        "focal": "Focal length, given in one of three ways.",
        "principal_offset_px": "Principal point minus image centre, right and down.",
        "distortion": "Lens distortion, Brown–Conrady in OpenCV's order and signs.",
        "beta_deg": "Tilt β: the angle between optical axis and gravity.",
        "tilt_azimuth_deg": "Direction of the tilt, counter-clockwise from outboard, seen from above.",
        "roll_deg": "Turn of the camera about its optical axis.",
        "offset_x_m": "Camera centre minus rope exit O, outboard.",
        "offset_y_m": "Camera centre minus rope exit O, sideways (y of the jib frame).",
        "offset_z_m": "Camera centre minus rope exit O, upwards.",
        "mount": "How the camera is mounted.",
    },
    "PixelFocal": {"focal_length_px": "Focal length in pixels."},
    "LensFocal": {
        "focal_length_mm": "Focal length of the lens.",
        "pixels_per_mm": "Pixel density of the sensor.",
    },
    "SensorFocal": {
        "focal_length_mm": "Focal length of the lens.",
        "sensor_diagonal_mm": "Diagonal of the sensor, which is read out whole.",
    },
    "Lens": {
        "k1": "First radial coefficient.",
        "k2": "Second radial coefficient.",
        "p1": "First tangential coefficient.",
        "p2": "Second tangential coefficient.",
        "k3": "Third radial coefficient.",
    },
    "LevelledMount": _VIBRATION | {
        "frequency_hz": "Natural frequency of the suspended camera.",
        "damping": "Share of critical damping.",
    },
    "RigidMount": _VIBRATION | {"pitch_deg_per_m": "Pitch of the camera per metre of luffing."},
    "FixedMount": _VIBRATION,
    "Vibration": {
        "rms_deg": "RMS of each component of the tilt.",
        "frequency_hz": "Centre of its narrow band.",
        "damping": "Width of the band, as a share of critical damping.",
    },
    "Iid": _ROPE | {
        "alpha": "The swing angle α.",
        "gamma_deg": "Azimuth of the swing minus that of the camera's tilt.",
        "rope_length_m": "Distance from the rope exit O to the grab centre A; within 6 to 45 m.",
        "yaw_deg": "Turn of the grab about the rope; 0 has its x axis outboard.",
        "absent": "Share of frames without grab and ropes.",
        "clamp": "Keys of which impossible draws are replaced by the nearest possible values, or `true` for both; "
        "others are an error.",
    },
    "Alpha": {
        "sigma_deg": "Scale: √E[α²], for every distribution.",
        "law": "Shape of the distribution of α; its own scale has no effect.",
    },
    "Dynamic": {
        "work": "What the crane does.",
        "start": "How the grab swings when a clip begins.",
        "wind": "Wind on the grab.",
        "forcing": "Random horizontal acceleration of the grab.",
        "damping": "Damping of the swing, as a share of critical damping; wind drag is added.",
        "yaw_damping": "Damping of the yaw, as a share of critical damping.",
        "radius_m": "Working radius of the jib head when a clip begins.",
        "drag_area_m2": "Drag coefficient times area of the grab; by default from its shape.",
        "settle_s": "Time simulated before the first frame of a clip.",
    },
    "OneBody": _WAVED,
    "FourRopes": _WAVED | {"tilt_ratio": "Lean of the grab's head over that of its ropes: 0 stays level."},
    "DoublePendulum": _WAVED | {"damping": "Damping of the grab against the ropes, as a share of critical damping."},
    "Waves": {
        "modes": "Number of string modes; 0 is none.",
        "damping": "Share of each mode's critical damping.",
        "exit_rms_m_s2": "RMS of each horizontal component of the acceleration of the rope exits.",
        "bandwidth_hz": "Frequency up to which it is white noise.",
    },
    "Lidar": _CLOCK | {
        "position_m": "Place on the slewing platform: outboard of the slewing axis, sideways, above the quay.",
        "elevation_deg": "Lowest and highest beam, above the horizontal.",
        "azimuth_deg": "First and last beam, counter-clockwise from outboard, seen from above.",
        "rings": "Number of elevations.",
        "columns": "Number of azimuths.",
        "rate_hz": "Scans a second.",
        "range_m": "Shortest and longest distance that is measured.",
        "range_noise_m": "Standard deviation of a distance.",
        "angle_noise_deg": "Standard deviation of a beam's elevation and azimuth.",
        "resolution_m": "Size of a count of the distance.",
        "dropout": "Share of beams that get lost in clear air.",
        "false_echo": "Share of the beams intercepted by rain, snow or fog that report a point in the air.",
    },
    "Markers": {
        "plate": "Plate with marks on the grab.",
        "target": "Bright disc on the grab.",
        "balls": "Balls between the ropes.",
    },
    "Circles": _PLATE | {"size_m": "Edge of the plate."},
    "AprilTag": _PLATE | {"size_m": "Edge of the tag's black square.", "tag": "Number of the tag in its family."},
    "Target": {
        "diameter_m": "Diameter of the disc.",
        "position_m": "Middle of the disc from that of the rope ends, grab frame.",
        "rgb": "Colour: red, green and blue from 0 to 1.",
    },
    "Balls": {
        "distances_m": "Distance of each ball from O.",
        "diameter_m": "Diameter of a ball.",
        "rgb": "Colour: red, green and blue from 0 to 1.",
    },
    "SideCamera": {
        "mount": "What it is mounted on: the slewing platform or the jib head.",
        "position_m": "Place: outboard of the slewing axis, sideways, above the quay; or from O.",
        "azimuth_deg": "Direction of the optical axis, counter-clockwise from outboard, seen from above.",
        "elevation_deg": "Direction of the optical axis above the horizontal.",
        "width_px": "Width of the picture.",
        "height_px": "Height of the picture.",
        "focal_length_px": "Focal length in pixels.",
        "rate_hz": "Pictures a second.",
    },
    "Hang": _ROPE,
    "Turn": _ROPE | {
        "slew_rpm": "Final slewing speed; its sign is the direction.",
        "ramp_s": "Time to reach the final speed.",
        "wait_s": "Time at rest before slewing begins.",
    },
    "Cycles": {
        "dig_rope_m": "Rope length at which the grab digs.",
        "carry_rope_m": "Rope length at which the grab is carried.",
        "dig_slew_deg": "Slew angle at which it digs, from the middle of the place.",
        "slew_deg": "Slewing from digging to dumping.",
        "luff_m": "Change of radius from digging to dumping; positive is outwards.",
        "operator": "Handling: 0 has the longest ramps, 1 the shortest, and moves follow before the swing has decayed.",
        "variation": "Relative variation of depths, speeds and pauses from cycle to cycle.",
        "hoist_m_min": "Hoisting speed.",
        "hoist_m_s2": "Hoisting acceleration.",
        "slew_rpm": "Slewing speed.",
        "luff_m_min": "Luffing speed.",
        "dig_s": "Time for digging.",
        "dump_s": "Time for dumping.",
        "pause_s": "Pause between moves.",
        "abrupt_every": "Every how many cycles slewing is braked abruptly; 0 is never.",
        "abrupt_s": "Time of an abrupt braking.",
    },
    "Start": {
        "alpha_deg": "Swing angle at the beginning.",
        "azimuth_deg": "Azimuth of the swing, counter-clockwise from outboard, seen from above.",
        "roundness": "0 swings in a plane, 1 or -1 in a circle.",
        "yaw_deg": "Turn of the grab about the rope.",
    },
    "Wind": {
        "mean_m_s": "Mean wind at the jib head.",
        "azimuth_deg": "Azimuth that the wind blows towards at time 0.",
        "intensity": "Turbulence: standard deviation over mean.",
        "scale_m": "Length scale of the von Karman turbulence.",
    },
    "Forcing": {
        "rms_m_s2": "RMS of the acceleration.",
        "bandwidth_hz": "Frequency up to which it is white noise.",
    },
    "FourRope": _LOOKS,
    "Clamshell": _SHAPED | _SHELLS | _DRIVE | {
        "arms": "Number of arms between shells and head.",
        "head": "Kind of head.",
    },
    "OrangePeel": _SHAPED | _DRIVE | {
        "tines": "Number of tines.",
        "shells": "How much of the bowl the tines' plates close.",
    },
    "Scissors": _SHAPED | _SHELLS,
    "Assembled": _LOOKS | _ROPES | {
        "shape": "Selects the shape; every value gives another one.",
        "volume_m3": "Scales the size; it is not what the grab holds.",
    },
    "Mesh": _LOOKS | _ROPES | {
        "file": "GLB, glTF, OBJ, PLY or STL file; its path is absolute or from the scene file's folder.",
        "sha256": "Digest of the file; filled in when the file is read.",
        "scale": "Metres per unit of the file.",
        "up": "Axis of the file that points up; auto is y in glTF and GLB, z in others.",
        "yaw_deg": "Turn about the vertical.",
        "centre_m": "Grab centre A; by default on the ropes' axis, at half the height.",
        "rope_ends_m": "Where the ropes end; by default at the top of the middle.",
        "lips_m": "Ends of the cutting edges, as keypoints.",
        "mass_kg": "Mass; by default estimated from the shape.",
        "drag_area_m2": "Drag coefficient times area; by default estimated from the shape.",
        "finish": "Colours of the file, or paint as on other grabs.",
        "jaws": "Moving parts.",
    },
    "Jaw": {
        "node": "Node of the file, with all below it.",
        "hinge_m": "Point on the axis.",
        "axis": "Direction of the axis.",
        "open_deg": "Rotation from closed to open, right-handed.",
        "stroke_m": "Travel along the axis from closed to open.",
        "lips_m": "Ends of its cutting edge, as keypoints.",
    },
    "Jib": {
        "head_height_m": "Height of the rope exit O above the quay.",
        "head": "Whether the steel of the jib head is there.",
        "rope_spread_x_m": "Distance between rope exits, outboard.",
        "rope_spread_y_m": "Distance between rope exits, sideways.",
        "rope_diameter_mm": "Diameter of the ropes.",
    },
    "Quay": _CARGO | _WORN | {
        "receiver": "What the cargo is dumped into.",
        "pile_height_m": "Height of the bulk pile; 0 is none.",
    },
    "Hold": _CARGO | _WORN | {
        "fill": "How full the hold is.",
        "depth_m": "Depth of the hold.",
    },
    "Photo": {
        "file": "Photograph, video, or folder of photographs; its path is absolute or from the scene file's folder.",
        "sha256": "SHA-256 of the content; it is filled in when the scene is read.",
    },
    "Water": {
        "freeboard_m": "Height of the ship's deck above the water.",
        "quay_height_m": "Height of the quay above the water.",
        "chop": "Waves: 0 is calm.",
    },
    "Clutter": {
        "other_grabs": "Number of parked grabs, as far as there is level ground for them.",
        "kinds": "Kinds that are drawn.",
    },
    "Light": {
        "sun_elevation_deg": "Elevation of the sun.",
        "sun_azimuth_deg": "Azimuth of the sun, counter-clockwise from outboard, seen from above.",
        "sun": "Light of the sun, relative to a clear day.",
        "sky": "Light of the sky, relative to a clear day.",
        "floodlights": "Light of the jib's floodlights 28 m below, relative to a clear day; needs sun = 0.",
    },
    "Optics": {
        "vignetting_stops": "Loss of light at the corner farthest from the axis.",
        "defocus_px": "Diameter of the circle of confusion.",
        "chromatic_px": "Shift of red outwards and of blue inwards at that corner.",
        "exposure": "Fixed or automatic exposure.",
        "sensor": "Noise of the sensor.",
        "night_mode": "Grey image: off, on, or auto, which depends on the gain.",
        "white_balance": "Gains of red, green and blue after the sensor; grey images have none.",
        "sharpening": "Sharpening by the camera.",
        "recompress_quality": "JPEG quality of an earlier compression, from 1 to 100; 0 is none.",
    },
    "Sharpening": {
        "amount": "Added share of what a Gaussian blur takes away; 0 is off.",
        "radius_px": "Standard deviation of that Gaussian.",
    },
    "FixedExposure": {"exposure_ev": "Exposure, relative to that of the rendered scene."},
    "AutoExposure": {
        "exposure_ev": "Brighter than the target by so many stops.",
        "target_level": "Mean linear luminance of the image, where 1 is white.",
        "lag_s": "Time constant of the exposure.",
        "max_gain_db": "Largest gain in the dark.",
        "night_gain_db": 'Gain from which night_mode = "auto" turns the image grey.',
    },
    "Sensor": {
        "full_well_e": "Electrons of white at 0 dB, at least 100; 0 switches shot noise off.",
        "read_noise_e": "Standard deviation of the read noise; needs full_well_e.",
        "fixed_pattern_percent": "Standard deviation of the pixels' response, the same in every frame.",
    },
    "Weather": {
        "visibility_m": "Meteorological visibility in fog: black keeps 2 % of its contrast there. Absent: clear air.",
        "rain_mm_h": "Rate of rain.",
        "snow_mm_h": "Rate of snow as melted water: light below 1, heavy above 2.5.",
        "wind_m_s": "Wind that carries drops, flakes and dust.",
        "wind_azimuth_deg": "Azimuth that this wind blows towards.",
        "dust_thickness": "Optical thickness through the middle of a fresh cloud of dust.",
        "dust_radius_m": "Standard deviation of the fresh cloud.",
        "drift_thickness": "Mean optical thickness, from above, of dust driven over the ground.",
        "wetness": "0 is dry; 0.5 wets every pore; up to 1 puddles spread.",
        "snow_cover": "Share of level surfaces under snow, the grab's too.",
        "lens_drops": "Number of water drops on the cover glass.",
        "lens_drop_mm": "Median size of these drops.",
        "lens_dirt": "Share of the glass under dirt.",
        "lens_snow": "Share of the glass under snow, which grows from its rim.",
    },
    "Image": {
        "format": "File format of the images.",
        "quality": "JPEG quality.",
        "samples": "Samples per pixel for antialiasing; 0 is none.",
        "shadow_map_px": "Side of the shadow map; 0 is no shadows.",
        "ids": "Whether to store what each pixel shows.",
        "depth": "Whether to store the depth of each pixel.",
    },
    "Shutter": {
        "exposure_s": "Exposure time of each row.",
        "rolling_s": "Time from the first row's exposure to the last row's.",
    },
    "Clip": {
        "frame_rate_hz": "Frames per second.",
        "clip_frames": "Frames of a clip; 0 makes all frames one clip.",
        "bit_rate_mbit_s": "Bit rate of the video.",
        "gop_frames": "Frames from one key frame to the next.",
        "drop_share": "Share of frames that are lost and leave a gap.",
        "repeat_share": "Share of the other frames that repeat the previous image.",
        "jitter_ms": "Standard deviation of the time stamps.",
    },
    "Display": {
        "layout": "Name of a bundled layout (two-by-four, four-point-four), a layout's own table, or none.",
        "start": "Local date and time of the clock at time 0.",
        "lag_s": "How old the displayed lengths are.",
        "refresh_hz": "Refresh rate of the lengths.",
        "readout_s": "Time to read out the image; a refresh within it tears the display.",
        "constant_m": "How much shorter the displayed lengths are than the true ones.",
        "font": "Font of the rope lengths; the clock keeps the bundled one.",
    },
    "BundledFont": _INK,
    "FontFile": _INK
    | {
        "file": "TTF or OTF file; its path is absolute or from the scene file's folder.",
        "sha256": "SHA-256 of the file; filled in when it is read.",
    },
    "GeneratedFont": {
        "style": "How digits are made: of pen strokes, seven segments, dots, or any of these.",
        "shape": "Chooses the font; without it, each independent frame, or each clip, shows a random one.",
        "ink": "Colours, outline and plate; drawn with the font unless given.",
    },
    "Ink": {
        "fill_rgb": "Colour of the digits: red, green and blue from 0 to 1, sRGB.",
        "outline_rgb": "Colour of the outline, sRGB.",
        "outline": "Width of the outline, relative to the font's size; 0 is none.",
        "plate_rgb": "Colour of the plate behind each number, sRGB.",
        "plate": "Opacity of the plate; 0 is none.",
    },
    "Layout": {
        "width_px": "Width of the image in which the layout was measured.",
        "height_px": "Height of that image.",
        "clock": "Place of the clock.",
        "digit_width_px": "Width of a digit's cell.",
        "digit_height_px": "Height of a digit's cell.",
        "hoist_px": "Top left corners of the hoisting rope's four digits.",
        "closing_px": "Top left corners of the closing rope's four digits.",
        "decimals": "How many of the four digits are decimals of a metre.",
        "point": "Whether a decimal point stands before the decimals.",
    },
    "Clock": {
        "x_px": "Left end of its line.",
        "y_px": "Top of its line.",
        "size_px": "Height of its line.",
    },
    "Labels": {"least_visible_fraction": "Least visible fraction of the grab for a detection box."},
    "Splits": {
        "train": "Share of the training split.",
        "val": "Share of the validation split.",
        "test": "Share of the test split. The three sum to 1.",
    },
    "HalfNormal": {"scale": "Standard deviation of the normal distribution."},
    "Rayleigh": {
        "scale": "Standard deviation of each of the two components.",
        "high": "Upper end, where it is truncated.",
    },
    "Exponential": {"mean": "Mean."},
    "Normal": {
        "mean": "Mean before truncation.",
        "sd": "Standard deviation before truncation.",
        "low": "Lower end, where it is truncated.",
        "high": "Upper end, where it is truncated.",
    },
    "Imu": _MOUNTED | {"noise": "Class of sensor, or a table of errors.", "rate_hz": "Readings a second."},
    "ImuNoise": _CLOCK
    | _errors_of("gyroscope", "rad/s/√Hz", "rad/s²/√Hz", "bias_deg_s")
    | _errors_of("accelerometer", "m/s²/√Hz", "m/s³/√Hz", "bias_m_s2"),
    "Inclinometer": _CLOCK
    | _READ
    | _MOUNTED
    | {
        "bandwidth_hz": "Corner frequency of the low-pass filter, of first order.",
        "noise_deg": "Standard deviation of the noise of a reading.",
    },
    "SlewEncoder": _CLOCK | _READ,
    "LuffEncoder": _CLOCK | _LENGTH,
    "HoistEncoder": _CLOCK | _LENGTH,
    "Uniform": {"low": "Lower end.", "high": "Upper end."},
    "Constant": {"value": "The value."},
    "Choice": {
        "values": "Values to choose from.",
        "weights": "Weights of the values; equal unless given. They need not sum to 1.",
    },
    "OneOf": {
        "values": "Values of any kind to choose from.",
        "weights": "Weights of the values; equal unless given. They need not sum to 1.",
        "names": "What labels call the values.",
    },
}  # fmt: skip


def describe(schema: dict[str, Any]) -> dict[str, Any]:
    """Return a JSON schema of scenes with a description of every key.

    Raises
    ------
    KeyError
        If a key has none.
    """
    definitions = {}
    for name, table in schema["$defs"].items():
        keys = dict(table.get("properties", {}))
        for key, value in keys.items():
            text = "Selects this kind." if key in _TAGS else DESCRIPTIONS[name][key]
            keys[key] = value | {"description": text}
        definitions[name] = table | ({"properties": keys} if keys else {})
    return schema | {"$defs": definitions}


def unit_of(key: str) -> str:
    """Give the unit of a key, which is the suffix of its name; empty where it has none.

    Examples
    --------
    >>> unit_of("beta_deg"), unit_of("hoist_m_s2"), unit_of("wear")
    ('°', 'm/s²', '')
    """
    return next((unit for suffix, unit in _UNITS.items() if f"_{key}".endswith(f"_{suffix}")), "")
