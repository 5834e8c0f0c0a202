!> Checks between keys and between groups, and of the files that a scene names.
!>
!> A value that is missing or already found wrong is left alone here: one slip, one message.
module gimp_scene_checks
  use gimp_common_kinds, only: dp
  use gimp_text, only: text_of
  use gimp_scene_mistakes, only: mistakes_t, suggestion, note_mistake
  use gimp_scene_store, only: scene_t, count_groups, is_given, usable, line_of, note_key, note_group, &
                              real_of, reals_of, integers_of, word_of, text_of_key, logical_of, texts_of
  use gimp_scene_mesh_checks, only: check_mesh, check_mesh_sides
  implicit none(type, external)
  private
  public :: check_scene

contains

  !> Note every mistake that shows only when keys are seen together
  subroutine check_scene(scene, mistakes)
    type(scene_t), intent(in) :: scene
    type(mistakes_t), intent(inout) :: mistakes
    call check_kinematics(scene, mistakes)
    call check_background(scene, mistakes)
    call check_grid(scene, mistakes)
    call check_mesh(scene, mistakes)
    call check_materials(scene, mistakes)
    call check_bodies(scene, mistakes)
    call check_boundaries(scene, mistakes)
    call check_loads(scene, mistakes)
    call check_time(scene, mistakes)
    call check_output(scene, mistakes)
    call check_verification(scene, mistakes)
  end subroutine check_scene

  pure subroutine check_kinematics(scene, mistakes)
    type(scene_t), intent(in) :: scene
    type(mistakes_t), intent(inout) :: mistakes
    character(len=*), parameter :: fitting(3) = [character(len=15) :: "uniaxial_strain", "plane_strain", "full"]
    if (scene%dimension == 0) return
    if (.not. usable(scene, "scene", 1, "kinematics")) return
    if (word_of(scene, "scene", 1, "kinematics") == fitting(scene%dimension)) return
    call note_key(mistakes, scene, "scene", 1, "kinematics", "a scene of dimension "//text_of(scene%dimension)//' takes "'// &
                  trim(fitting(scene%dimension))//'"')
  end subroutine check_kinematics

  !> A grid or a mesh
  pure subroutine check_background(scene, mistakes)
    type(scene_t), intent(in) :: scene
    type(mistakes_t), intent(inout) :: mistakes
    integer :: grids, meshes
    grids = count_groups(scene, "grid")
    meshes = count_groups(scene, "mesh")
    if (grids == 0 .and. meshes == 0) call note_mistake(mistakes, 0, "&grid: the group is missing (the box of the background grid "// &
                                                        "and its spacing), and so is &mesh; a scene has one of the two")
    if (grids > 0 .and. meshes > 0) call note_group(mistakes, scene, "mesh", 1, "cannot stand together with &grid; give one of the two")
  end subroutine check_background

  !> A whole number of cells on every axis
  pure subroutine check_grid(scene, mistakes)
    type(scene_t), intent(in) :: scene
    type(mistakes_t), intent(inout) :: mistakes
    real(dp) :: lower(3), upper(3), edge, spacing
    character(len=:), allocatable :: what
    integer :: d
    if (scene%dimension == 0 .or. count_groups(scene, "grid") == 0) return
    call check_corners(scene, "grid", 1, mistakes)
    if (.not. (usable(scene, "grid", 1, "lower") .and. usable(scene, "grid", 1, "upper"))) return
    if (.not. usable(scene, "grid", 1, "spacing")) return
    lower(:scene%dimension) = reals_of(scene, "grid", 1, "lower")
    upper(:scene%dimension) = reals_of(scene, "grid", 1, "upper")
    spacing = real_of(scene, "grid", 1, "spacing")
    do d = 1, scene%dimension
      edge = upper(d) - lower(d)
      if (edge <= 0.0_dp) cycle ! told by check_corners
      what = ""
      if (spacing < 1.0e-9_dp*edge) then
        what = "cuts the box into more than a billion cells along "//axis_name(d)
      else if (abs(edge/spacing - anint(edge/spacing)) > 1.0e-6_dp .or. edge < 0.5_dp*spacing) then
        what = "does not divide the box along "//axis_name(d)//": "//text_of(edge, 9)//" m are "// &
          text_of(edge/spacing, 9)//" cells; a whole number is wanted"
      end if
      if (what /= "") call note_key(mistakes, scene, "grid", 1, "spacing", what)
    end do
  end subroutine check_grid

  !> lower < upper on every axis
  pure subroutine check_corners(scene, group, which, mistakes)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group
    integer, intent(in) :: which
    type(mistakes_t), intent(inout) :: mistakes
    real(dp) :: lower(3), upper(3)
    integer :: d
    if (scene%dimension == 0) return
    if (.not. (usable(scene, group, which, "lower") .and. usable(scene, group, which, "upper"))) return
    lower(:scene%dimension) = reals_of(scene, group, which, "lower")
    upper(:scene%dimension) = reals_of(scene, group, which, "upper")
    do d = 1, scene%dimension
      if (upper(d) > lower(d)) cycle
      call note_key(mistakes, scene, group, which, "upper", "must be above lower along "//axis_name(d)//": "// &
                    text_of(upper(d), 9)//" is not above "//text_of(lower(d), 9))
    end do
  end subroutine check_corners

  !> One number must be below another
  pure subroutine check_order(scene, group, which, small, large, mistakes)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, small, large
    integer, intent(in) :: which
    type(mistakes_t), intent(inout) :: mistakes
    if (.not. (usable(scene, group, which, small) .and. usable(scene, group, which, large))) return
    if (real_of(scene, group, which, small) < real_of(scene, group, which, large)) return
    call note_key(mistakes, scene, group, which, small, "must be below "//large//" = "// &
                  text_of(real_of(scene, group, which, large), 9))
  end subroutine check_order

  pure function axis_name(d) result(name)
    integer, intent(in) :: d
    character(len=1) :: name
    character(len=3), parameter :: names = "xyz"
    name = names(d:d)
  end function axis_name

  !> Names are unique within groups of one kind
  pure subroutine check_names(scene, group, mistakes)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group
    type(mistakes_t), intent(inout) :: mistakes
    character(len=256), allocatable :: name(:) !! all names, asked for once: a scene may hold many bodies
    integer :: i, j
    allocate (name(count_groups(scene, group)))
    do i = 1, size(name)
      name(i) = ""
      if (usable(scene, group, i, "name")) name(i) = text_of_key(scene, group, i, "name")
    end do
    do i = 2, size(name)
      j = findloc(name(:i - 1), name(i), dim=1)
      if (j == 0 .or. name(i) == "") cycle
      call note_key(mistakes, scene, group, i, "name", "the name is taken by the &"//group//" of line "// &
                    text_of(line_of(scene, group, j, "name")))
    end do
  end subroutine check_names

  !> The number of the group whose name is the value of a key; 0 if there is none, which is noted unless a name is mistaken
  pure subroutine look_up(scene, group, which, key, target, found, mistakes)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    character(len=*), intent(in) :: target !! group whose names are meant
    integer, intent(in) :: which
    integer, intent(out) :: found
    type(mistakes_t), intent(inout) :: mistakes
    character(len=:), allocatable :: name, names
    integer :: i
    found = 0
    if (.not. usable(scene, group, which, key)) return
    name = text_of_key(scene, group, which, key)
    names = ""
    if (count_groups(scene, target) == 0) return
    do i = count_groups(scene, target), 1, -1
      if (.not. usable(scene, target, i, "name")) return
      if (text_of_key(scene, target, i, "name") == name) found = i
      names = text_of_key(scene, target, i, "name")//" "//names
    end do
    if (found > 0) return
    call note_key(mistakes, scene, group, which, key, "no &"//target//" has this name; "//suggestion(name, names, '"'))
  end subroutine look_up

  pure subroutine check_materials(scene, mistakes)
    type(scene_t), intent(in) :: scene
    type(mistakes_t), intent(inout) :: mistakes
    integer :: m
    call check_names(scene, "material", mistakes)
    do m = 1, count_groups(scene, "material")
      call check_rate(scene, m, mistakes)
      if (.not. (usable(scene, "material", m, "dilation_angle") .and. usable(scene, "material", m, "friction_angle"))) cycle
      if (real_of(scene, "material", m, "dilation_angle") <= real_of(scene, "material", m, "friction_angle")) cycle
      call note_key(mistakes, scene, "material", m, "dilation_angle", "must be at most friction_angle = "// &
                    text_of(real_of(scene, "material", m, "friction_angle")))
    end do
  end subroutine check_materials

  !> The increment is turned by definition in every rate but that of Hughes & Winget
  pure subroutine check_rate(scene, m, mistakes)
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: m
    type(mistakes_t), intent(inout) :: mistakes
    if (.not. (usable(scene, "material", m, "rate") .and. usable(scene, "material", m, "rate_form"))) return
    if (word_of(scene, "material", m, "rate_form") /= "plain" .or. word_of(scene, "material", m, "rate") == "hughes_winget") return
    call note_key(mistakes, scene, "material", m, "rate_form", "is for rate = 'hughes_winget'; midpoint or symmetric is wanted with "// &
                  "rate = '"//trim(word_of(scene, "material", m, "rate"))//"'")
  end subroutine check_rate

  subroutine check_bodies(scene, mistakes)
    type(scene_t), intent(in) :: scene
    type(mistakes_t), intent(inout) :: mistakes
    integer :: b, found, adding
    call check_names(scene, "body", mistakes)
    adding = 0
    do b = 1, count_groups(scene, "body")
      call look_up(scene, "body", b, "material", "material", found, mistakes)
      if (.not. usable(scene, "body", b, "operation")) then
        adding = adding + 1 ! in doubt for the author
      else if (word_of(scene, "body", b, "operation") == "add") then
        adding = adding + 1
      else if (adding == 0) then
        call note_key(mistakes, scene, "body", b, "operation", "no body stands above it that it could carve")
      end if
      call check_shape(scene, b, mistakes)
      call check_initial(scene, b, mistakes)
      if (usable(scene, "body", b, "file")) call check_file(scene, b, mistakes)
    end do
  end subroutine check_bodies

  subroutine check_file(scene, b, mistakes)
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: b
    type(mistakes_t), intent(inout) :: mistakes
    logical :: exists
    inquire (file=text_of_key(scene, "body", b, "file"), exist=exists)
    if (.not. exists) call note_key(mistakes, scene, "body", b, "file", "there is no such file")
  end subroutine check_file

  pure subroutine check_shape(scene, b, mistakes)
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: b
    type(mistakes_t), intent(inout) :: mistakes
    character(len=:), allocatable :: shape
    real(dp), allocatable :: points(:)
    if (.not. usable(scene, "body", b, "shape") .or. scene%dimension == 0) return
    shape = word_of(scene, "body", b, "shape")
    select case (shape)
    case ("box")
      call check_corners(scene, "body", b, mistakes)
    case ("cylinder", "ring")
      if (scene%dimension == 1) call note_key(mistakes, scene, "body", b, "shape", 'a scene of dimension 1 takes "box" or "sphere"')
      call check_order(scene, "body", b, "inner_radius", "outer_radius", mistakes)
      call check_order(scene, "body", b, "axis_lower", "axis_upper", mistakes)
    case ("polygon")
      if (scene%dimension /= 2) then
        call note_key(mistakes, scene, "body", b, "shape", "a polygon belongs to a scene of dimension 2, this one has "// &
                      text_of(scene%dimension))
      else if (usable(scene, "body", b, "points")) then
        allocate (points, source=reals_of(scene, "body", b, "points"))
        if (polygon_fault(points) /= "") call note_key(mistakes, scene, "body", b, "points", polygon_fault(points))
      end if
    case ("file")
      if (word_of(scene, "body", b, "operation") == "subtract") &
        call note_key(mistakes, scene, "body", b, "operation", "particles of a file can only be added")
    case ("elements")
      call check_elements(scene, b, mistakes)
    end select
    call check_cuts(scene, b, mistakes)
    if (.not. usable(scene, "body", b, "fill")) return
    if (word_of(scene, "body", b, "fill") /= "polar") return
    if (scene%dimension == 2 .and. (shape == "ring" .or. shape == "sphere")) return
    call note_key(mistakes, scene, "body", b, "fill", "polar particles are for a ring or sphere in 2D, not for a "//shape// &
                  " in "//text_of(scene%dimension)//"D")
  end subroutine check_shape

  !> Elements of the mesh: they can only be added, and are cut equally along all their edges
  pure subroutine check_elements(scene, b, mistakes)
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: b
    type(mistakes_t), intent(inout) :: mistakes
    integer, allocatable :: parts(:)
    if (count_groups(scene, "mesh") == 0) &
      call note_key(mistakes, scene, "body", b, "shape", "needs a &mesh, whose elements are filled; this scene has a &grid")
    if (word_of(scene, "body", b, "operation") == "subtract") &
      call note_key(mistakes, scene, "body", b, "operation", "elements can only be added")
    if (.not. usable(scene, "body", b, "particles_per_axis")) return
    allocate (parts, source=integers_of(scene, "body", b, "particles_per_axis"))
    if (any(parts /= parts(1))) &
      call note_key(mistakes, scene, "body", b, "particles_per_axis", "elements are cut equally along all their edges; one number is wanted")
  end subroutine check_elements

  !> Cutting planes: as many points as normals, and no normal of length zero
  pure subroutine check_cuts(scene, b, mistakes)
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: b
    type(mistakes_t), intent(inout) :: mistakes
    real(dp), allocatable :: normal(:)
    logical :: with_point, with_normal
    integer :: k, d, n_points
    with_point = is_given(scene, "body", b, "cut_point")
    with_normal = is_given(scene, "body", b, "cut_normal")
    if (with_point .and. .not. with_normal) call note_key(mistakes, scene, "body", b, "cut_point", "needs cut_normal as well")
    if (with_normal .and. .not. with_point) call note_key(mistakes, scene, "body", b, "cut_normal", "needs cut_point as well")
    if (.not. usable(scene, "body", b, "cut_normal")) return
    d = scene%dimension
    allocate (normal, source=reals_of(scene, "body", b, "cut_normal"))
    do k = 1, size(normal)/d
      if (maxval(abs(normal((k - 1)*d + 1:k*d))) > 0.0_dp) cycle
      call note_key(mistakes, scene, "body", b, "cut_normal", "normal "//text_of(k)//" has no length")
    end do
    if (.not. usable(scene, "body", b, "cut_point")) return
    n_points = size(reals_of(scene, "body", b, "cut_point"))
    if (n_points /= size(normal)) call note_key(mistakes, scene, "body", b, "cut_normal", "has "//text_of(size(normal)/d)// &
                                                " normals for "//text_of(n_points/d)//" points of cut_point")
  end subroutine check_cuts

  !> What is wrong with the corners x1,y1, x2,y2, ... of a polygon; empty if nothing is
  pure function polygon_fault(points) result(what)
    real(dp), intent(in) :: points(:)
    character(len=:), allocatable :: what
    integer :: n, i, j
    what = ""
    n = size(points)/2
    if (n < 3) then
      what = "has "//text_of(n)//" corners; a polygon needs at least 3"
      return
    end if
    do i = 1, n
      j = modulo(i, n) + 1
      if (all(corner(i) == corner(j))) then
        what = "corners "//text_of(i)//" and "//text_of(j)//" are the same point"
        return
      end if
    end do
    do i = 1, n
      do j = i + 2, n
        if (i == 1 .and. j == n) cycle ! neighbours share a corner
        if (.not. edges_meet(corner(i), corner(modulo(i, n) + 1), corner(j), corner(modulo(j, n) + 1))) cycle
        what = "edges "//text_of(i)//" and "//text_of(j)//" cross or touch; a polygon must not cross itself"
        return
      end do
    end do
    if (all([(turn(corner(1), corner(2), corner(i)), i=3, n)] == 0.0_dp)) what = "all corners lie on one line"
  contains
    pure function corner(k)
      integer, intent(in) :: k
      real(dp) :: corner(2)
      corner = points(2*k - 1:2*k)
    end function corner
  end function polygon_fault

  !> Whether the straight edges a-b and c-d have a point in common
  pure logical function edges_meet(a, b, c, d)
    real(dp), intent(in) :: a(2), b(2), c(2), d(2)
    real(dp) :: c_side, d_side, a_side, b_side
    c_side = turn(a, b, c)
    d_side = turn(a, b, d)
    a_side = turn(c, d, a)
    b_side = turn(c, d, b)
    edges_meet = (c_side*d_side < 0.0_dp .and. a_side*b_side < 0.0_dp) .or. (c_side == 0.0_dp .and. between(a, b, c)) .or. &
      (d_side == 0.0_dp .and. between(a, b, d)) .or. (a_side == 0.0_dp .and. between(c, d, a)) .or. &
      (b_side == 0.0_dp .and. between(c, d, b))
  end function edges_meet

  !> 1 if the way a-b-c turns left, -1 if right, 0 if straight
  pure real(dp) function turn(a, b, c)
    real(dp), intent(in) :: a(2), b(2), c(2)
    real(dp) :: left, right
    left = (b(1) - a(1))*(c(2) - a(2))
    right = (b(2) - a(2))*(c(1) - a(1))
    turn = 0.0_dp
    if (left > right) turn = 1.0_dp
    if (left < right) turn = -1.0_dp
  end function turn

  !> Whether c, on the line through a and b, lies between the two
  pure logical function between(a, b, c)
    real(dp), intent(in) :: a(2), b(2), c(2)
    between = all(c >= min(a, b) .and. c <= max(a, b))
  end function between

  !> The initial state of a body
  pure subroutine check_initial(scene, b, mistakes)
    type(scene_t), intent(in) :: scene
    integer, intent(in) :: b
    type(mistakes_t), intent(inout) :: mistakes
    if (usable(scene, "body", b, "initial") .and. count_groups(scene, "verification") == 0) then
      if (word_of(scene, "body", b, "initial") == "verification") &
        call note_key(mistakes, scene, "body", b, "initial", "needs a group &verification")
    end if
    if (scene%dimension == 0 .or. .not. usable(scene, "body", b, "deformation_gradient")) return
    if (determinant(reals_of(scene, "body", b, "deformation_gradient"), scene%dimension) > 0.0_dp) return
    call note_key(mistakes, scene, "body", b, "deformation_gradient", "the determinant must be above 0")
  end subroutine check_initial

  pure real(dp) function determinant(f, d)
    real(dp), intent(in) :: f(:) !! row by row
    integer, intent(in) :: d !! rows
    select case (d)
    case (1)
      determinant = f(1)
    case (2)
      determinant = f(1)*f(4) - f(2)*f(3)
    case default
      determinant = f(1)*(f(5)*f(9) - f(6)*f(8)) - f(2)*(f(4)*f(9) - f(6)*f(7)) + f(3)*(f(4)*f(8) - f(5)*f(7))
    end select
  end function determinant

  !> times and factors: both or none, equally many, increasing
  pure subroutine check_table(scene, group, which, mistakes)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group
    integer, intent(in) :: which
    type(mistakes_t), intent(inout) :: mistakes
    real(dp), allocatable :: times(:)
    integer :: n, k
    logical :: with_times, with_factors
    with_times = is_given(scene, group, which, "times")
    with_factors = is_given(scene, group, which, "factors")
    if (with_times .and. .not. with_factors) call note_key(mistakes, scene, group, which, "times", "needs factors as well")
    if (with_factors .and. .not. with_times) call note_key(mistakes, scene, group, which, "factors", "needs times as well")
    if (.not. usable(scene, group, which, "times")) return
    allocate (times, source=reals_of(scene, group, which, "times"))
    do k = 2, size(times)
      if (times(k) > times(k - 1)) cycle
      call note_key(mistakes, scene, group, which, "times", "must increase; "//text_of(times(k), 9)//" follows "// &
                    text_of(times(k - 1), 9))
      exit
    end do
    if (.not. usable(scene, group, which, "factors")) return
    n = size(reals_of(scene, group, which, "factors"))
    if (n /= size(times)) call note_key(mistakes, scene, group, which, "factors", "has "//text_of(n)//" values for "// &
                                        text_of(size(times))//" times; as many are wanted")
  end subroutine check_table

  !> One condition per side, sides that exist, periodic on both sides of an axis
  pure subroutine check_boundaries(scene, mistakes)
    type(scene_t), intent(in) :: scene
    type(mistakes_t), intent(inout) :: mistakes
    integer :: owner(6) !! group that sets side 2*axis-1 (low) or 2*axis (high)
    logical :: periodic(6)
    integer :: b, s, first, last
    owner = 0
    periodic = .false.
    do b = 1, count_groups(scene, "boundary")
      call check_table(scene, "boundary", b, mistakes)
    end do
    if (count_groups(scene, "mesh") > 0) then
      call check_mesh_sides(scene, mistakes)
      return
    end if
    do b = 1, count_groups(scene, "boundary")
      if (.not. usable(scene, "boundary", b, "side") .or. scene%dimension == 0) cycle
      call side_range(scene, "boundary", b, "side", first, last, mistakes)
      do s = first, last
        if (owner(s) /= 0) then
          call note_key(mistakes, scene, "boundary", b, "side", "this side has a condition already, from line "// &
                        text_of(line_of(scene, "boundary", owner(s), "side")))
          exit
        end if
        owner(s) = b
        if (usable(scene, "boundary", b, "condition")) periodic(s) = word_of(scene, "boundary", b, "condition") == "periodic"
      end do
    end do
    do s = 1, 6
      first = s + merge(1, -1, mod(s, 2) == 1) ! the side across
      if (.not. periodic(s) .or. periodic(first)) cycle
      call note_key(mistakes, scene, "boundary", owner(s), "condition", "the side across, "//side_name(first)// &
                    ", must be periodic too")
    end do
  end subroutine check_boundaries

  pure function side_name(s) result(name)
    integer, intent(in) :: s !! 2*axis-1 low, 2*axis high
    character(len=:), allocatable :: name
    name = axis_name((s + 1)/2)//"_low"
    if (mod(s, 2) == 0) name = axis_name((s + 1)/2)//"_high"
  end function side_name

  !> The sides that a word means: one, or all; an empty range, which is noted, if the scene has no such axis
  pure subroutine side_range(scene, group, which, key, first, last, mistakes)
    type(scene_t), intent(in) :: scene
    character(len=*), intent(in) :: group, key
    integer, intent(in) :: which
    integer, intent(out) :: first, last
    type(mistakes_t), intent(inout) :: mistakes
    first = 1
    last = 2*scene%dimension
    if (word_of(scene, group, which, key) == "all") return
    do first = 1, 6
      if (side_name(first) == word_of(scene, group, which, key)) exit
    end do
    last = first
    if (first <= 2*scene%dimension) return
    last = first - 1
    call note_key(mistakes, scene, group, which, key, "a scene of dimension "//text_of(scene%dimension)//" has no such side")
  end subroutine side_range

  pure subroutine check_loads(scene, mistakes)
    type(scene_t), intent(in) :: scene
    type(mistakes_t), intent(inout) :: mistakes
    integer :: k, found, first, last
    do k = 1, count_groups(scene, "load")
      call check_table(scene, "load", k, mistakes)
      if (usable(scene, "load", k, "side") .and. count_groups(scene, "mesh") == 0) &
        call note_key(mistakes, scene, "load", k, "side", "names sides of a &mesh; with a &grid give body and face")
      call look_up(scene, "load", k, "body", "body", found, mistakes)
      if (found > 0) then
        if (word_of(scene, "body", found, "operation") == "subtract") &
          call note_key(mistakes, scene, "load", k, "body", "this body is subtracted and has no particles")
        if (word_of(scene, "body", found, "shape") == "elements" .and. usable(scene, "load", k, "face")) &
          call note_key(mistakes, scene, "load", k, "face", "this body is filled from elements, not on a lattice that has faces; name sides of "// &
                        "the mesh with side in place of body and face")
      end if
      if (scene%dimension > 0 .and. usable(scene, "load", k, "face")) &
        call side_range(scene, "load", k, "face", first, last, mistakes)
    end do
  end subroutine check_loads

  pure subroutine check_time(scene, mistakes)
    type(scene_t), intent(in) :: scene
    type(mistakes_t), intent(inout) :: mistakes
    character(len=*), parameter :: keys(2) = [character(len=16) :: "step", "smallest_step"]
    integer :: k
    if (count_groups(scene, "time") == 0) return
    do k = 1, size(keys)
      if (.not. (usable(scene, "time", 1, trim(keys(k))) .and. usable(scene, "time", 1, "end"))) cycle
      if (real_of(scene, "time", 1, trim(keys(k))) <= real_of(scene, "time", 1, "end")) cycle
      call note_key(mistakes, scene, "time", 1, trim(keys(k)), "must be at most end = "// &
                    text_of(real_of(scene, "time", 1, "end"), 9))
    end do
  end subroutine check_time

  !> The folder of the output exists and nothing is overwritten unasked
  subroutine check_output(scene, mistakes)
    type(scene_t), intent(in) :: scene
    type(mistakes_t), intent(inout) :: mistakes
    character(len=:), allocatable :: name, folder
    integer :: slash
    logical :: exists
    if (usable(scene, "output", 1, "fields") .and. count_groups(scene, "verification") == 0) then
      if (any(texts_of(scene, "output", 1, "fields") == "error")) &
        call note_key(mistakes, scene, "output", 1, "fields", '"error" needs a group &verification')
    end if
    if (.not. usable(scene, "output", 1, "name")) return
    name = text_of_key(scene, "output", 1, "name")
    slash = index(name, "/", back=.true.)
    if (slash == len(name)) then
      call note_key(mistakes, scene, "output", 1, "name", "must end with the name of a file, not of a folder")
      return
    end if
    if (index(name, ".vtkhdf") > 0 .and. index(name, ".vtkhdf") == len(name) - 6) &
      call note_key(mistakes, scene, "output", 1, "name", "is written without .vtkhdf, which is added")
    if (slash > 0) then
      folder = name(:slash)
      inquire (file=folder//".", exist=exists)
      if (.not. exists) then
        call note_key(mistakes, scene, "output", 1, "name", "there is no folder "//folder//"; make it first")
        return
      end if
    end if
    if (text_of_key(scene, "restart", 1, "from") /= "") return ! the file must be there then
    if (.not. usable(scene, "output", 1, "overwrite")) return
    if (logical_of(scene, "output", 1, "overwrite")) return
    inquire (file=name//".vtkhdf", exist=exists)
    if (exists) call note_key(mistakes, scene, "output", 1, "name", name//".vtkhdf exists; choose another name or set "// &
                              "overwrite = .true.")
  end subroutine check_output

  pure subroutine check_verification(scene, mistakes)
    type(scene_t), intent(in) :: scene
    type(mistakes_t), intent(inout) :: mistakes
    if (count_groups(scene, "verification") == 0) return
    call check_order(scene, "verification", 1, "inner_radius", "outer_radius", mistakes)
    if (.not. usable(scene, "verification", 1, "solution") .or. scene%dimension == 0) return
    select case (word_of(scene, "verification", 1, "solution"))
    case ("vortex", "expanding_ring", "rigid_rotation")
      if (scene%dimension == 1) call note_key(mistakes, scene, "verification", 1, "solution", &
                                              "this solution needs dimension 2 or 3")
    end select
  end subroutine check_verification

end module gimp_scene_checks
