!> What the author of a scene may write: one row per group and one row per key.
!>
!> This table alone says what a key is called, how many values it takes, what it means when it is left out and which
!> choice reads it. Checking, suggestions, the complete scene in the output file, `gimp.x --help GROUP` and the input
!> reference all walk it. Strings have a fixed length on purpose: an array constructor of types with allocatable
!> components leaks in gfortran 12.
module gimp_scene_keys
  implicit none(type, external)
  private
  public :: key_t, group_t, list_groups, list_keys
  public :: kind_real, kind_integer, kind_logical, kind_word, kind_text
  public :: count_one, count_axis, count_tensor, count_one_or_axis, count_list, count_points, count_rotation
  public :: word_most, text_most

  integer, parameter :: kind_real = 1, kind_integer = 2, kind_logical = 3
  integer, parameter :: kind_word = 4 !! one of a list, lower case after reading
  integer, parameter :: kind_text = 5 !! free text, kept as written

  integer, parameter :: count_one = 1
  integer, parameter :: count_axis = 2 !! as many as the scene has dimensions
  integer, parameter :: count_tensor = 3 !! dimension squared, row by row
  integer, parameter :: count_one_or_axis = 4 !! one for all axes, or one per axis
  integer, parameter :: count_list = 5 !! 1 to `most` values
  integer, parameter :: count_points = 6 !! `dimension` numbers per point, one point after the other
  integer, parameter :: count_rotation = 7 !! one number in 2D, three in 3D

  integer, parameter :: word_most = 32 !! characters in the name of a material or body
  integer, parameter :: text_most = 256 !! characters in any other text

  !> A key of a group
  type :: key_t
    character(len=12) :: group = ""
    character(len=24) :: name = ""
    integer :: kind = kind_real
    integer :: count = count_one
    integer :: most = 0 !! values in a list, characters in a text; -k with count_points: k points
    character(len=8) :: unit = ""
    !> Values with commas between; empty: none; "?key,key word,word=value ..." by the values of other keys, * any ("dimension" is the
    !> scene's); "(words)" explains a default that only the program can work out
    character(len=128) :: default = ""
    logical :: empty_default = .false. !! the default is the empty text
    character(len=16) :: range = "" !! "(0,1]": round brackets exclude the end; an end may be left out
    character(len=208) :: words = "" !! allowed words, blank between
    character(len=64) :: planned = "" !! words that are known but not built yet
    logical :: required = .false. !! where the choices in `when` read it
    character(len=112) :: when = "" !! "key=word|word key=word": read only if all hold; empty: always
    character(len=32) :: needed_when = "" !! if given: required only where this holds too
    character(len=24) :: unless = "" !! a key that takes the place of this one: only one of the two may be given
    character(len=12) :: names_with = "" !! with this group in the scene any name will do in place of the words
    character(len=160) :: purpose = ""
  end type key_t

  !> A group of the scene
  type :: group_t
    character(len=12) :: name = ""
    integer :: least = 0
    integer :: most = 1 !! 0: any number
    logical :: planned = .false. !! known, not built yet
    character(len=112) :: purpose = ""
  end type group_t

  character(len=*), parameter :: sides = "x_low x_high y_low y_high z_low z_high all"

contains

  !> The groups in the order of the input reference
  pure subroutine list_groups(groups)
    type(group_t), allocatable, intent(out) :: groups(:)
    allocate (groups(15))
    groups(1) = group_t("scene", 1, 1, .false., "what the scene is called and its dimension")
    groups(2) = group_t("grid", 0, 1, .false., "the box of the background grid and its spacing; a scene has this group or &mesh")
    groups(3) = group_t("mesh", 0, 1, .false., "an unstructured mesh of a file in place of the grid")
    groups(4) = group_t("material", 1, 0, .false., "a material that bodies name; one group each")
    groups(5) = group_t("body", 1, 0, .false., "a region filled with particles, or one carved from the bodies above it")
    groups(6) = group_t("boundary", 0, 0, .false., "what happens on a side of the box or the mesh; a side without one is free")
    groups(7) = group_t("load", 0, 0, .false., "gravity, traction, pressure or a point force; one group each")
    groups(8) = group_t("method", 0, 1, .false., "basis, transfer, order of the step, damping")
    groups(9) = group_t("time", 1, 1, .false., "end of the run and how the step is chosen")
    groups(10) = group_t("output", 0, 1, .false., "name of the output file, frames, history, probes")
    groups(11) = group_t("verification", 0, 1, .false., "an exact solution: it gives start, body force and error norms")
    groups(12) = group_t("contact", 0, 0, .true., "contact between bodies")
    groups(13) = group_t("restart", 0, 1, .false., "when checkpoints are written, the one to go on from, and the wall-clock limit")
    groups(14) = group_t("parallel", 0, 1, .false., "how many threads work, and how ranks share the work; results do not depend on it")
    groups(15) = group_t("refine", 0, 1, .true., "refinement of grid and particles")
  end subroutine list_groups

  !> Every key, group by group
  pure subroutine list_keys(keys)
    type(key_t), allocatable, intent(out) :: keys(:)
    type(key_t), allocatable :: table(:)
    integer :: n
    allocate (table(200))
    n = 0
    call scene_keys(table, n)
    call material_keys(table, n)
    call body_keys(table, n)
    call boundary_keys(table, n)
    call load_keys(table, n)
    call method_keys(table, n)
    call time_keys(table, n)
    call output_keys(table, n)
    call restart_keys(table, n)
    call parallel_keys(table, n)
    call verification_keys(table, n)
    allocate (keys(n))
    keys = table(:n)
  end subroutine list_keys

  !> Add a row to the table
  pure subroutine add(table, n, group, name, kind, purpose, count, most, unit, default, empty_default, range, words, &
                      planned, required, when, needed_when, unless, names_with)
    type(key_t), intent(inout) :: table(:)
    integer, intent(inout) :: n
    character(len=*), intent(in) :: group, name, purpose
    integer, intent(in) :: kind
    integer, intent(in), optional :: count, most
    character(len=*), intent(in), optional :: unit, default, range, words, planned, when, needed_when, unless, names_with
    logical, intent(in), optional :: empty_default, required
    n = n + 1
    table(n)%group = group
    table(n)%name = name
    table(n)%kind = kind
    table(n)%purpose = purpose
    if (kind == kind_text) table(n)%most = text_most
    if (present(count)) table(n)%count = count
    if (present(most)) table(n)%most = most
    if (present(unit)) table(n)%unit = unit
    if (present(default)) table(n)%default = default
    if (present(empty_default)) table(n)%empty_default = empty_default
    if (present(range)) table(n)%range = range
    if (present(words)) table(n)%words = words
    if (present(planned)) table(n)%planned = planned
    if (present(required)) table(n)%required = required
    if (present(when)) table(n)%when = when
    if (present(needed_when)) table(n)%needed_when = needed_when
    if (present(unless)) table(n)%unless = unless
    if (present(names_with)) table(n)%names_with = names_with
  end subroutine add

  !> &scene, &grid and &mesh
  pure subroutine scene_keys(t, n)
    type(key_t), intent(inout) :: t(:)
    integer, intent(inout) :: n
    call add(t, n, "scene", "title", kind_text, "a line for the header and the output file", empty_default=.true.)
    call add(t, n, "scene", "dimension", kind_integer, "number of space dimensions", range="[1,3]", required=.true.)
    call add(t, n, "scene", "kinematics", kind_word, "what the missing dimensions do; must fit the dimension", &
             words="plane_strain uniaxial_strain full", default="?dimension 1=uniaxial_strain 2=plane_strain 3=full")
    call add(t, n, "grid", "lower", kind_real, "lower corner of the box", count_axis, unit="m", required=.true.)
    call add(t, n, "grid", "upper", kind_real, "upper corner of the box, above lower on every axis", count_axis, unit="m", &
             required=.true.)
    call add(t, n, "grid", "spacing", kind_real, "edge of a cell; the box must hold a whole number of cells on every axis", &
             unit="m", range="(0,)", required=.true.)
    call add(t, n, "mesh", "file", kind_text, "mesh file of this project (preprocessing/ makes one of what Gmsh and others write)", &
             required=.true.)
    call add(t, n, "mesh", "reference_length", kind_real, "takes the place of the spacing of a grid where a length is in cells: "// &
             "lattices of particles, limits of domains", unit="m", range="(0,)", default="(mean size of the elements)")
    call add(t, n, "mesh", "search_rule", kind_word, "in which order neighbours are asked for a particle that left its element: by the "// &
             "angle to its velocity, or by the signs of its components", words="velocity component", default="velocity")
  end subroutine scene_keys

  pure subroutine material_keys(t, n)
    type(key_t), intent(inout) :: t(:)
    integer, intent(inout) :: n
    character(len=*), parameter :: g = "material", plastic = "model=hencky_von_mises", soil = "model=drucker_prager"
    call add(t, n, g, "name", kind_text, "what bodies call it; unique", most=word_most, required=.true.)
    call add(t, n, g, "model", kind_word, "constitutive model", required=.true., &
             words="neo_hookean linear_elastic hencky hencky_von_mises drucker_prager")
    call add(t, n, g, "density", kind_real, "density before deformation", unit="kg/m3", range="(0,)", required=.true.)
    call add(t, n, g, "young_modulus", kind_real, "Young's modulus", unit="Pa", range="(0,)", required=.true.)
    call add(t, n, g, "poisson_ratio", kind_real, "Poisson's ratio", range="(-1,0.5)", required=.true.)
    call add(t, n, g, "yield_stress", kind_real, "von Mises stress at first yield", unit="Pa", range="(0,)", &
             required=.true., when=plastic)
    call add(t, n, g, "hardening", kind_word, "how the yield stress sy grows with the equivalent plastic strain ep", &
             words="none linear power", default="none", when=plastic)
    call add(t, n, g, "hardening_modulus", kind_real, "H in sy = yield_stress + H*ep", unit="Pa", range="[0,)", default="0", &
             when=plastic//" hardening=linear")
    call add(t, n, g, "hardening_exponent", kind_real, "n in sy = yield_stress*(1 + ep/hardening_strain)**n", range="(0,1]", &
             default="1", when=plastic//" hardening=power")
    call add(t, n, g, "hardening_strain", kind_real, "reference strain of the power law", range="(0,)", required=.true., &
             when=plastic//" hardening=power")
    call add(t, n, g, "cohesion", kind_real, "Mohr-Coulomb cohesion", unit="Pa", range="[0,)", default="0", when=soil)
    call add(t, n, g, "friction_angle", kind_real, "Mohr-Coulomb angle of friction", unit="degree", range="[0,89)", &
             required=.true., when=soil)
    call add(t, n, g, "dilation_angle", kind_real, "angle of dilation, at most friction_angle", unit="degree", &
             range="[0,89)", default="0", when=soil)
    call add(t, n, g, "cone", kind_word, "how the cone is fitted to Mohr-Coulomb: equal in plane strain, through the outer "// &
             "edges, or the inner ones", words="plane_strain outer inner", default="plane_strain", when=soil)
    call add(t, n, g, "rate", kind_word, "objective rate of the stress", &
             words="hughes_winget jaumann green_naghdi truesdell logarithmic", default="hughes_winget", when="model=linear_elastic")
    call add(t, n, g, "rate_form", kind_word, "midpoint: D and W of the middle of the step; symmetric: of its start; plain: the "// &
             "same, and the increment is not turned (hughes_winget only)", words="midpoint symmetric plain", default="midpoint", &
             when="model=linear_elastic rate=hughes_winget|green_naghdi|truesdell|logarithmic")
  end subroutine material_keys

  pure subroutine body_keys(t, n)
    type(key_t), intent(inout) :: t(:)
    integer, intent(inout) :: n
    character(len=*), parameter :: g = "body"
    character(len=*), parameter :: shapes = "box|sphere|cylinder|ring|polygon", shaped = "operation=add shape="//shapes
    character(len=*), parameter :: filled = shaped//"|elements", resting = filled//" initial=rest"
    call add(t, n, g, "name", kind_text, "what loads call it; unique", most=word_most, required=.true.)
    call add(t, n, g, "material", kind_text, "name of a &material; a body that is subtracted needs none", most=word_most, &
             required=.true., needed_when="operation=add")
    call add(t, n, g, "shape", kind_word, "form of the region", required=.true., &
             words="box sphere cylinder ring polygon elements file")
    call add(t, n, g, "operation", kind_word, "add: takes the points that no body above has taken; subtract: removes its "// &
             "region from all bodies above it", words="add subtract", default="add")
    call add(t, n, g, "lower", kind_real, "lower corner", count_axis, unit="m", required=.true., when="shape=box")
    call add(t, n, g, "upper", kind_real, "upper corner, above lower on every axis", count_axis, unit="m", required=.true., &
             when="shape=box")
    call add(t, n, g, "center", kind_real, "centre; in 3D any point of the axis of a cylinder or ring", count_axis, unit="m", &
             required=.true., when="shape=sphere|cylinder|ring")
    call add(t, n, g, "radius", kind_real, "radius; a sphere is an interval in 1D, a disk in 2D", unit="m", range="(0,)", &
             required=.true., when="shape=sphere|cylinder")
    call add(t, n, g, "inner_radius", kind_real, "inner radius, below outer_radius", unit="m", range="[0,)", required=.true., &
             when="shape=ring")
    call add(t, n, g, "outer_radius", kind_real, "outer radius", unit="m", range="(0,)", required=.true., when="shape=ring")
    call add(t, n, g, "axis", kind_word, "direction of the axis in 3D", words="x y z", default="z", &
             when="shape=cylinder|ring dimension=3")
    call add(t, n, g, "axis_lower", kind_real, "where the cylinder begins along its axis (3D)", unit="m", required=.true., &
             when="shape=cylinder|ring dimension=3")
    call add(t, n, g, "axis_upper", kind_real, "where it ends, above axis_lower (3D)", unit="m", required=.true., &
             when="shape=cylinder|ring dimension=3")
    call add(t, n, g, "points", kind_real, "corners x1,y1, x2,y2, ... in order around the polygon (2D), not crossing itself", &
             count_points, most=400, unit="m", required=.true., when="shape=polygon")
    call add(t, n, g, "cut_point", kind_real, "a point on each of up to four cutting planes", count_points, most=-4, &
             unit="m", when="shape="//shapes, default="(no cut)")
    call add(t, n, g, "cut_normal", kind_real, "normal of each cutting plane; the side it points to is removed", &
             count_points, most=-4, when="shape="//shapes, default="(no cut)")
    call add(t, n, g, "group", kind_text, "group of elements of the mesh; empty: all its elements", most=word_most, &
             empty_default=.true., when="shape=elements")
    call add(t, n, g, "fill", kind_word, "where particles are put: a lattice along the axes, or rings (ring and sphere in 2D)", &
             words="cartesian polar", default="cartesian", when=shaped)
    call add(t, n, g, "particles_per_axis", kind_integer, "particles per cell and axis; with elements n: an edge is cut into n parts, "// &
             "an element into n, n*n or n*n*n like it", count_one_or_axis, range="[1,16]", &
             default="2", when=filled//" fill=cartesian")
    call add(t, n, g, "radial_particles", kind_integer, "particles from the inner to the outer radius", range="[1,)", &
             required=.true., &
             when=shaped//" fill=polar")
    call add(t, n, g, "angular_particles", kind_integer, "particles around the circle", range="[3,)", required=.true., &
             when=shaped//" fill=polar")
    call add(t, n, g, "initial", kind_word, "rest: the keys below; verification: velocity, F and position from "// &
             "&verification", words="rest verification", default="rest", when=filled)
    call add(t, n, g, "velocity", kind_real, "initial velocity", count_axis, unit="m/s", default="0", when=resting)
    call add(t, n, g, "angular_velocity", kind_real, "initial spin about rotation_center", count_rotation, unit="rad/s", &
             default="0", when=resting//" dimension=2|3")
    call add(t, n, g, "velocity_gradient", kind_real, "initial velocity gradient about rotation_center, row by row", &
             count_tensor, unit="1/s", default="0", when=resting)
    call add(t, n, g, "rotation_center", kind_real, "fixed point of spin and velocity gradient", count_axis, unit="m", &
             default="(centre of the body)", when=resting)
    call add(t, n, g, "deformation_gradient", kind_real, "initial deformation gradient F, row by row, of positive determinant", &
             count_tensor, default="?dimension 1=1 2=1,0,0,1 3=1,0,0,0,1,0,0,0,1", when=resting)
    call add(t, n, g, "file", kind_text, "HDF5 file with datasets position, volume, mass and, if wished, velocity, "// &
             "deformation_gradient, half_length, corner, stress, id", required=.true., when="shape=file")
  end subroutine body_keys

  pure subroutine boundary_keys(t, n)
    type(key_t), intent(inout) :: t(:)
    integer, intent(inout) :: n
    character(len=*), parameter :: g = "boundary"
    call add(t, n, g, "side", kind_word, "side of the box, or a name of sides that the mesh has; a side has one condition", &
             words=sides, names_with="mesh", required=.true.)
    call add(t, n, g, "condition", kind_word, "what the side does; periodic needs both sides of an axis (not on a mesh)", required=.true., &
             words="stick slip symmetry periodic velocity free")
    call add(t, n, g, "velocity", kind_real, "velocity of the nodes of the side", count_axis, unit="m/s", required=.true., &
             when="condition=velocity")
    call add(t, n, g, "times", kind_real, "increasing times of factors, which are joined by straight lines", count_list, &
             most=100, unit="s", when="condition=velocity", default="(factor 1)")
    call add(t, n, g, "factors", kind_real, "factor on velocity at each of times", count_list, most=100, &
             when="condition=velocity", default="(factor 1)")
    call add(t, n, g, "leaving", kind_word, "a particle that leaves there: the run fails, or it is removed and counted", &
             words="error remove", default="error", when="condition=free")
  end subroutine boundary_keys

  pure subroutine load_keys(t, n)
    type(key_t), intent(inout) :: t(:)
    integer, intent(inout) :: n
    character(len=*), parameter :: g = "load"
    call add(t, n, g, "kind", kind_word, "what kind of load", words="gravity traction pressure point_force", required=.true.)
    call add(t, n, g, "body", kind_text, "name of the &body it acts on", most=word_most, required=.true., &
             when="kind=traction|pressure|point_force", unless="side")
    call add(t, n, g, "acceleration", kind_real, "acceleration of all bodies", count_axis, unit="m/s2", required=.true., &
             when="kind=gravity")
    call add(t, n, g, "traction", kind_real, "force per area of the deformed face, direction kept", count_axis, unit="Pa", &
             required=.true., when="kind=traction")
    call add(t, n, g, "pressure", kind_real, "pressure, positive pushes inwards", unit="Pa", required=.true., &
             when="kind=pressure")
    call add(t, n, g, "face", kind_word, "faces of the body's fill lattice with that outward normal and no neighbour", &
             words=sides, required=.true., when="kind=traction|pressure", unless="side")
    call add(t, n, g, "side", kind_text, "sides of the mesh that it acts on, in place of body and face", most=word_most, &
             when="kind=traction|pressure", default="(body and face)")
    call add(t, n, g, "force", kind_real, "force", count_axis, unit="N", required=.true., when="kind=point_force")
    call add(t, n, g, "point", kind_real, "the force acts on the particle of the body that starts nearest to it", count_axis, &
             unit="m", required=.true., when="kind=point_force")
    call add(t, n, g, "ramp_time", kind_real, "smooth rise from 0 to the full load; 0: at once", unit="s", range="[0,)", &
             default="0", unless="times")
    call add(t, n, g, "times", kind_real, "increasing times of factors, which are joined by straight lines", count_list, &
             most=100, unit="s", default="(factor 1)")
    call add(t, n, g, "factors", kind_real, "factor on the load at each of times", count_list, most=100, default="(factor 1)")
  end subroutine load_keys

  pure subroutine method_keys(t, n)
    type(key_t), intent(inout) :: t(:)
    integer, intent(inout) :: n
    character(len=*), parameter :: g = "method", series = "transfer=xpic|fmpm"
    call add(t, n, g, "basis", kind_word, "shape functions", words="linear ugimp cpgimp cpdi cpdi2 gauss_gimp ddmp bspline2 bspline3", &
             default="cpgimp")
    call add(t, n, g, "spline_boundary", kind_word, "splines at the sides of the box. open: knots end there, material must stay "// &
             "inside; ghost: equal splines that reach beyond, for periodic and symmetric sides", words="open ghost", &
             default="open", when="basis=bspline2|bspline3")
    call add(t, n, g, "ddmp_alpha", kind_real, "alpha in the middle of a cell: the share of the tent's own gradient, which is 0 on "// &
             "faces; the rest is smeared over the nodes", range="[0,1]", default="0.5", when="basis=ddmp")
    call add(t, n, g, "domain", kind_word, "half length of a particle's domain from the stretch U, from F_kk, or from the "// &
             "volume", words="stretch diagonal volume", default="stretch", when="basis=cpgimp")
    call add(t, n, g, "quadrature", kind_word, "points of GIMP weights over the deformed voxel: Simpson's for S and G; Gauss points "// &
             "with G from the faces; or with G at the points", words="simpson surface volume", default="simpson", &
             when="basis=gauss_gimp")
    call add(t, n, g, "quadrature_points", kind_integer, "Gauss points along an axis", range="[1,4]", default="2", &
             when="basis=gauss_gimp quadrature=surface|volume")
    call add(t, n, g, "domain_limit", kind_real, "longer half diagonals of a domain are shortened, for the weights only", &
             unit="cells", range="(0,2]", default="?basis cpdi2=2 *=1", when="basis=cpdi|cpdi2|gauss_gimp")
    call add(t, n, g, "particle_domain", kind_word, "quadrilaterals and hexahedra, or parts of cells cut into 2 triangles or 6 "// &
             "tetrahedra, a particle each", words="box simplex", default="box", when="basis=cpdi2 dimension=2|3")
    call add(t, n, g, "cpdi2_volume", kind_word, "of a particle in its internal force: of the domain between its corners, or J V0", &
             words="domain material", default="domain", when="basis=cpdi2")
    call add(t, n, g, "cpdi2_deformation", kind_word, "F by deformation_update from the velocity gradient, or (with usl) from the "// &
             "corners of the domain and those of its reference shape", words="incremental total", default="incremental", &
             when="basis=cpdi2")
    call add(t, n, g, "domain_overlap", kind_real, "factor on the half lengths of domains in the weights (fuzzy particles): above 1 "// &
             "domains overlap and mass is spread wider, at free surfaces too", range="[1,4]", default="1", &
             when="basis=ugimp|cpgimp|cpdi|gauss_gimp")
    call add(t, n, g, "transfer", kind_word, "how grid velocity comes back to particles", words="flip pic apic tpic mls xpic "// &
             "fmpm", default="?integrator,basis symplectic,linear=flip symplectic,ddmp=flip symplectic,*=apic *,*=flip")
    call add(t, n, g, "transfer_order", kind_integer, "terms of the series that approaches the consistent mass: m of XPIC(m), k of "// &
             "FMPM(k); 1 is PIC, each further one costs a pass", range="[1,)", default="2", when=series)
    call add(t, n, g, "transfer_every", kind_integer, "steps from one such transfer to the next, with FLIP between", range="[1,)", &
             default="1", when=series)
    call add(t, n, g, "position_update", kind_word, "grid: x + dt S v+; new (fmpm): x + dt v'; published: x + dt (v + v')/2 (fmpm), "// &
             "x + dt (S v + (v' - v)/2) (xpic), of first order", words="grid new published", default="?basis,transfer cpdi2,*=grid *,fmpm=new *,*=grid", &
             when=series)
    call add(t, n, g, "strain_velocity", kind_word, "velocity that strains come from: lumped, or the series to the same order", &
             words="lumped order_k", default="lumped", when="transfer=fmpm")
    call add(t, n, g, "flip_fraction", kind_real, "q in v' = S v+ + q (v - S v): the share of FLIP", range="[0,1]", &
             default="?integrator,transfer,basis symplectic,flip,linear=0.995 symplectic,flip,ddmp=0.995 *,flip,*=1 *,*,*=0.95", &
             when="transfer=flip|apic|tpic|mls")
    call add(t, n, g, "stress_update", kind_word, "where in the step stress is updated", words="usf usl musl usavg", &
             default="?integrator symplectic=musl *=usl")
    call add(t, n, g, "integrator", kind_word, "time integrator", words="symplectic generalized_alpha newmark", &
             default="symplectic", planned="implicit")
    call add(t, n, g, "spectral_radius", kind_real, "what a step leaves of the shortest waves; 1: no damping", range="[0,1]", &
             default="0.8", when="integrator=generalized_alpha")
    call add(t, n, g, "newmark_gamma", kind_real, "weight of the new acceleration in a velocity; above 0.5 waves are damped, at "// &
             "first order", range="[0.5,1]", default="0.5", when="integrator=newmark")
    call add(t, n, g, "formulation", kind_word, "updated: weights at present places; total: at those of the start, for bodies that "// &
             "start undeformed and touch nothing", words="updated total", default="updated")
    call add(t, n, g, "deformation_update", kind_word, "update of F from the velocity gradient", &
             words="forward cayley exponential", default="forward")
    call add(t, n, g, "anti_locking", kind_word, "f_bar, b_bar: change of volume averaged over the particles of a cell, in stress "// &
             "alone, or in the force too; cell_stress: the force takes the mean stress", &
             words="none f_bar b_bar cell_stress", default="none")
    call add(t, n, g, "null_space_filter", kind_integer, "steps between filters that take out of the velocities of a cell's particles "// &
             "what its nodes do not see; each sorts; 0: none", range="[0,)", default="0")
    call add(t, n, g, "half_step_start", kind_logical, "first velocity update is half a step, as leap-frog wants it", &
             default="?integrator symplectic=.true. *=.false.")
    call add(t, n, g, "mass_cutoff", kind_real, "nodes below this share of the largest particle mass are left out", &
             range="[0,1)", default="1e-12")
    call add(t, n, g, "redistribute_mass", kind_real, "nodes below this share of a full node's mass (least density times h^d) hand "// &
             "internal force on to the particle's other nodes (a pass more); 0: off", range="[0,1)", default="0")
    call add(t, n, g, "kernel", kind_word, "auto: the fast kernels; list: the plain reference kernel everywhere", &
             words="auto list", default="auto")
    call add(t, n, g, "sort_every", kind_integer, "steps between sorts; 0: only when a support could leave its pad", &
             range="[0,)", default="0")
    call add(t, n, g, "damping", kind_word, "damping towards rest", words="none local kinetic", default="none")
    call add(t, n, g, "damping_factor", kind_real, "share of the out-of-balance force that local damping takes", &
             range="[0,1)", default="0.7", when="damping=local")
  end subroutine method_keys

  pure subroutine time_keys(t, n)
    type(key_t), intent(inout) :: t(:)
    integer, intent(inout) :: n
    character(len=*), parameter :: g = "time"
    call add(t, n, g, "end", kind_real, "the run ends at this time", unit="s", range="(0,)", required=.true.)
    call add(t, n, g, "step_rule", kind_word, "adaptive: from the state; uniform: equal steps, from the initial wave speed; "// &
             "fixed: step", words="adaptive uniform fixed", default="adaptive")
    call add(t, n, g, "courant", kind_real, "Courant number; 1 is the step h/(c + v), with generalized_alpha "// &
             "and newmark as much as their limits allow of it (docs/method.md)", range="(0,1]", default="0.4", &
             when="step_rule=adaptive|uniform", unless="steps")
    call add(t, n, g, "step", kind_real, "length of a step", unit="s", range="(0,)", required=.true., when="step_rule=fixed")
    call add(t, n, g, "steps", kind_integer, "number of equal steps, in place of courant", range="[1,)", &
             when="step_rule=uniform", default="(from courant)")
    call add(t, n, g, "max_steps", kind_integer, "ends a run early; 0: no limit", range="[0,)", default="0")
    call add(t, n, g, "growth", kind_real, "largest ratio of a step to the one before", range="[1,)", default="1.05", &
             when="step_rule=adaptive")
    call add(t, n, g, "smallest_step", kind_real, "the run fails when the step falls below it", unit="s", range="[0,)", &
             default="0", when="step_rule=adaptive")
    call add(t, n, g, "stability_check", kind_word, "critical step of the present state, light nodes included, for the "// &
             "closing table; gershgorin: rigorous and cheap, lanczos: within a per cent", words="none gershgorin lanczos", &
             default="none")
    call add(t, n, g, "stability_every", kind_integer, "steps between checks", range="[1,)", default="100", &
             when="stability_check=gershgorin|lanczos")
    call add(t, n, g, "stability_limit", kind_real, "share of the critical step that a step may take; 0: it is reported only", &
             range="[0,1]", default="0", when="stability_check=gershgorin|lanczos step_rule=adaptive")
    call add(t, n, g, "redo_unstable_steps", kind_logical, "a step that inverts or loses a particle, or gains energy from "// &
             "nothing, is undone and taken again at half the length; needs a copy of the state", default=".false.", &
             when="step_rule=adaptive")
  end subroutine time_keys

  pure subroutine output_keys(t, n)
    type(key_t), intent(inout) :: t(:)
    integer, intent(inout) :: n
    character(len=*), parameter :: g = "output"
    call add(t, n, g, "name", kind_text, "output goes to NAME.vtkhdf; may hold a folder, which must exist", default="gimp")
    call add(t, n, g, "every", kind_real, "time between frames; 0: first and last only", unit="s", range="[0,)", default="0")
    call add(t, n, g, "fields", kind_word, "what a frame holds for each particle; error needs &verification", count_list, &
             most=24, words="displacement velocity stress smoothed_stress deformation_gradient pressure von_mises "// &
             "equivalent_plastic_strain volume mass density id material body jacobian half_length error "// &
             "reference_position", default="displacement,velocity,stress")
    call add(t, n, g, "precision", kind_word, "of the fields in a frame", words="single double", default="single")
    call add(t, n, g, "history_every", kind_integer, "steps between rows of the history", range="[1,)", default="10")
    call add(t, n, g, "csv", kind_logical, "write the history to NAME.history.csv as well", default=".false.")
    call add(t, n, g, "probes", kind_real, "points; the particle that starts nearest to each is followed", count_points, &
             most=60, unit="m", default="(none)")
    call add(t, n, g, "overwrite", kind_logical, "an existing NAME.vtkhdf is replaced", default=".false.")
    call add(t, n, g, "progress", kind_word, "auto: a live line on a terminal, plain lines in a log; on: plain lines everywhere", &
             words="auto on off", default="auto")
  end subroutine output_keys

  pure subroutine restart_keys(t, n)
    type(key_t), intent(inout) :: t(:)
    integer, intent(inout) :: n
    character(len=*), parameter :: g = "restart"
    call add(t, n, g, "every", kind_real, "simulated time between checkpoints; steps are not shortened to meet it; 0: none", &
             unit="s", range="[0,)", default="0")
    call add(t, n, g, "every_steps", kind_integer, "steps between checkpoints; 0: none", range="[0,)", default="0")
    call add(t, n, g, "every_minutes", kind_real, "wall-clock time between checkpoints; 0: none", unit="min", range="[0,)", &
             default="0")
    call add(t, n, g, "max_walltime", kind_real, "wall-clock time from the start of the program at which the run must be over: "// &
             "before that it writes a checkpoint and stops with exit code 75; 0: no limit", unit="min", range="[0,)", default="0")
    call add(t, n, g, "from", kind_text, "checkpoint to continue from; the command line says the same with --restart FILE", &
             empty_default=.true.)
  end subroutine restart_keys

  pure subroutine parallel_keys(t, n)
    type(key_t), intent(inout) :: t(:)
    integer, intent(inout) :: n
    call add(t, n, "parallel", "threads", kind_integer, "threads of the run; 0: OMP_NUM_THREADS, or one where that is not set", &
             range="[0,4096]", default="0")
    call add(t, n, "parallel", "repartition", kind_word, "balanced: blocks change their rank at sorts when the imbalance of work passes its limit; never; "// &
             "always: at every sort, for tests", words="balanced never always", default="balanced")
    call add(t, n, "parallel", "imbalance_limit", kind_real, "largest counted work of a rank over the mean that is let be", range="[1.01,100]", &
             default="1.1")
  end subroutine parallel_keys

  pure subroutine verification_keys(t, n)
    type(key_t), intent(inout) :: t(:)
    integer, intent(inout) :: n
    character(len=*), parameter :: g = "verification"
    call add(t, n, g, "solution", kind_word, "the exact solution", required=.true., words="vibrating_bar axis_aligned "// &
             "vortex expanding_ring self_weight_column rigid_translation rigid_rotation")
    call add(t, n, g, "amplitude", kind_real, "amplitude of the motion: m, for the vortex rad", range="(0,)", &
             default="?solution axis_aligned=0.05 vortex=0.1 expanding_ring=0.1", &
             when="solution=axis_aligned|vortex|expanding_ring")
    call add(t, n, g, "velocity", kind_real, "velocity of the translation", count_axis, unit="m/s", required=.true., &
             when="solution=rigid_translation")
    call add(t, n, g, "speed", kind_real, "largest initial velocity of the bar", unit="m/s", range="(0,)", default="0.1", &
             when="solution=vibrating_bar")
    call add(t, n, g, "length", kind_real, "length of the bar, height of the column", unit="m", range="(0,)", &
             default="?solution vibrating_bar=25 self_weight_column=50", when="solution=vibrating_bar|self_weight_column")
    call add(t, n, g, "period", kind_real, "period of the vortex", unit="s", range="(0,)", default="1", when="solution=vortex")
    call add(t, n, g, "angular_velocity", kind_real, "spin", count_rotation, unit="rad/s", required=.true., &
             when="solution=rigid_rotation dimension=2|3")
    call add(t, n, g, "center", kind_real, "origin of the solution's own coordinates", count_axis, unit="m", default="0", &
             when="solution=vibrating_bar|axis_aligned|vortex|expanding_ring|self_weight_column|rigid_rotation")
    call add(t, n, g, "inner_radius", kind_real, "inner radius, below outer_radius", unit="m", range="(0,)", &
             default="?solution vortex=0.75 expanding_ring=0.4", when="solution=vortex|expanding_ring")
    call add(t, n, g, "outer_radius", kind_real, "outer radius", unit="m", range="(0,)", &
             default="?solution vortex=1.25 expanding_ring=0.6", when="solution=vortex|expanding_ring")
    call add(t, n, g, "phases", kind_real, "phase of the motion along each axis", count_axis, unit="rad", &
             default="?dimension 1=0 2=0,3.141592653589793 3=0,3.141592653589793,0", when="solution=axis_aligned")
    call add(t, n, g, "gravity", kind_real, "gravity of the scene, pointing down the last axis", unit="m/s2", range="(0,)", &
             default="10", when="solution=self_weight_column")
  end subroutine verification_keys

end module gimp_scene_keys
