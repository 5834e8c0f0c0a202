!> Shapes of bodies: what they are, which points lie inside, how large they are.
!>
!> Points on a boundary, so that a rounding error of the coordinates cannot decide:
!> - box: lower face in, upper face out, so that boxes side by side share no point; the same for the height range of
!>   cylinders and rings;
!> - sphere, cylinder, ring: a point at exactly the radius is inside (both radii of the ring);
!> - polygon: an edge shared by two polygons gives its points to exactly one of them;
!> - cut: a point on the plane stays.
!> "Exactly" includes `slack`, 1e-12 of the largest coordinate or length of the shape.
module gimp_shapes
  use gimp_kinds, only: dp, i8, pi
  use gimp_error, only: error_t, add_error
  use gimp_text, only: text_of
  implicit none(type, external)
  private
  public :: shape_t, region_t, inside, shape_volume, shape_center, shape_bounds, check_shape, unbounded
  public :: shape_words, shape_none, shape_box, shape_sphere, shape_cylinder, shape_ring, shape_polygon, shape_region

  !> Shapes by name; the constants below are positions in this list. A particle file has no shape: it fills nothing here.
  character(len=*), parameter :: shape_words = "box sphere cylinder ring polygon file elements"
  integer, parameter :: shape_box = 1, shape_sphere = 2, shape_cylinder = 3, shape_ring = 4, shape_polygon = 5, shape_none = 6, &
    shape_region = 7

  real(dp), parameter :: unbounded = huge(1.0_dp) !! magnitude of a height limit that is not given
  real(dp), parameter :: slack = 1.0e-12_dp !! relative; far above round-off, far below any spacing

  !> A region that comes in pieces, such as the elements of a mesh, with a particle in each piece
  type, abstract :: region_t
  contains
    procedure(holds_i), deferred :: holds
    procedure(pieces_i), deferred :: pieces
    procedure(piece_i), deferred :: piece
  end type region_t

  abstract interface
    !> Does the point lie in the region?
    pure logical function holds_i(self, x)
      import :: region_t, dp
      implicit none(type, external)
      class(region_t), intent(in) :: self
      real(dp), intent(in) :: x(:) !! (dim) [m]
    end function holds_i

    !> How many pieces
    pure integer(i8) function pieces_i(self)
      import :: region_t, i8
      implicit none(type, external)
      class(region_t), intent(in) :: self
    end function pieces_i

    !> One of them
    pure subroutine piece_i(self, number, corners, corner, content, centroid)
      import :: region_t, dp, i8
      implicit none(type, external)
      class(region_t), intent(in) :: self
      integer(i8), intent(in) :: number !! from 1
      integer, intent(out) :: corners !! dim + 1 or 2**dim
      real(dp), intent(out) :: corner(:, :) !! (dim, 2**dim): the first `corners` of them, of cells with the first axis fastest [m]
      real(dp), intent(out) :: content !! [m^dim]
      real(dp), intent(out) :: centroid(:) !! (dim) [m]
    end subroutine piece_i
  end interface

  !> A region of space; which components are read depends on `kind`
  type :: shape_t
    integer :: kind = shape_none
    real(dp) :: lower(3) = 0.0_dp, upper(3) = 0.0_dp !! box, or the box around a region [m]
    real(dp) :: center(3) = 0.0_dp !! sphere, cylinder, ring [m]
    real(dp) :: radius = 0.0_dp !! sphere, cylinder [m]
    real(dp) :: inner_radius = 0.0_dp, outer_radius = 0.0_dp !! ring [m]
    integer :: axis = 3 !! cylinder and ring in 3D: 1, 2, 3 for x, y, z
    real(dp) :: axis_lower = -unbounded, axis_upper = unbounded !! their height range, absolute [m]
    real(dp), allocatable :: vertices(:, :) !! polygon: (2, vertices), either sense, not closed by a repeated vertex [m]
    class(region_t), pointer :: region => null()
    integer :: cuts = 0 !! half spaces taken away, at most 4
    real(dp) :: cut_point(3, 4) = 0.0_dp !! a point on each cutting plane [m]
    real(dp) :: cut_normal(3, 4) = 0.0_dp !! points to the side that is taken away, any length
  end type shape_t

contains

  !> Does the point lie inside? Only the first `dim` coordinates count.
  pure logical function inside(shape, dim, x)
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: dim
    real(dp), intent(in) :: x(3) !! [m]
    integer :: c
    real(dp) :: r, tolerance
    inside = .false.
    select case (shape%kind)
    case (shape_box)
      do c = 1, dim
        if (.not. in_range(x(c), shape%lower(c), shape%upper(c))) return
      end do
    case (shape_sphere, shape_cylinder, shape_ring)
      call measure_distance(shape, dim, x, r, tolerance)
      if (shape%kind == shape_ring) then
        if (r > shape%outer_radius + tolerance .or. r < shape%inner_radius - tolerance) return
      else
        if (r > shape%radius + tolerance) return
      end if
      if (dim == 3 .and. shape%kind /= shape_sphere) then
        if (.not. in_range(x(shape%axis), shape%axis_lower, shape%axis_upper)) return
      end if
    case (shape_polygon)
      if (.not. in_polygon(shape%vertices, x)) return
    case (shape_region)
      inside = shape%region%holds(x(:dim))
      return
    case default
      return
    end select
    do c = 1, shape%cuts
      if (beyond_cut(shape, c, dim, x)) return
    end do
    inside = .true.
  end function inside

  !> lower <= x < upper, both shifted down by the slack
  elemental logical function in_range(x, lower, upper)
    real(dp), intent(in) :: x, lower, upper
    real(dp) :: shift
    shift = abs(x)
    if (lower > -unbounded) shift = max(shift, abs(lower))
    if (upper < unbounded) shift = max(shift, abs(upper))
    shift = slack*shift
    in_range = x >= lower - shift .and. x < upper - shift
  end function in_range

  !> Distance from the centre, from the axis for a cylinder or ring in 3D; and the slack of that distance
  pure subroutine measure_distance(shape, dim, x, r, tolerance)
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: dim
    real(dp), intent(in) :: x(3)
    real(dp), intent(out) :: r, tolerance
    integer :: d
    r = 0.0_dp
    tolerance = max(shape%radius, shape%outer_radius)
    do d = 1, dim
      if (dim == 3 .and. d == shape%axis .and. shape%kind /= shape_sphere) cycle
      r = r + (x(d) - shape%center(d))**2
      tolerance = max(tolerance, abs(shape%center(d)))
    end do
    r = sqrt(r)
    tolerance = slack*tolerance
  end subroutine measure_distance

  !> Is the point on the side of the plane that is taken away?
  pure logical function beyond_cut(shape, c, dim, x)
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: c, dim
    real(dp), intent(in) :: x(3)
    real(dp) :: distance, size
    distance = dot_product(x(:dim) - shape%cut_point(:dim, c), shape%cut_normal(:dim, c))
    size = maxval(abs(x(:dim))) + maxval(abs(shape%cut_point(:dim, c)))
    beyond_cut = distance > slack*size*norm2(shape%cut_normal(:dim, c))
  end function beyond_cut

  !> Even-odd rule: a ray to the right crosses the boundary an odd number of times.
  !>
  !> An edge takes part for y_low <= y < y_high and is always computed from its lower end, so that two polygons which share
  !> the edge find the same crossing, to the bit.
  pure logical function in_polygon(vertices, x)
    real(dp), intent(in) :: vertices(:, :), x(3)
    integer :: k, low, high
    logical :: this_below, next_below
    in_polygon = .false.
    this_below = vertices(2, size(vertices, 2)) <= x(2)
    do k = 1, size(vertices, 2)
      next_below = vertices(2, k) <= x(2)
      if (this_below .neqv. next_below) then
        low = modulo(k - 2, size(vertices, 2)) + 1
        high = k
        if (next_below) then
          high = low
          low = k
        end if
        if (x(1) < vertices(1, low) + (x(2) - vertices(2, low)) &
          *((vertices(1, high) - vertices(1, low))/(vertices(2, high) - vertices(2, low)))) in_polygon = .not. in_polygon
      end if
      this_below = next_below
    end do
  end function in_polygon

  !> Volume [m3], area in 2D [m2], length in 1D [m]; -1 where there is no closed form (cuts, unlimited height, no shape)
  pure real(dp) function shape_volume(shape, dim) result(volume)
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: dim
    real(dp) :: height
    volume = -1.0_dp
    if (shape%cuts > 0) return
    height = 1.0_dp
    if (dim == 3 .and. (shape%kind == shape_cylinder .or. shape%kind == shape_ring)) then
      if (shape%axis_lower <= -unbounded .or. shape%axis_upper >= unbounded) return
      height = shape%axis_upper - shape%axis_lower
    end if
    select case (shape%kind)
    case (shape_box)
      volume = product(shape%upper(:dim) - shape%lower(:dim))
    case (shape_sphere)
      if (dim == 1) volume = 2.0_dp*shape%radius
      if (dim == 2) volume = pi*shape%radius**2
      if (dim == 3) volume = 4.0_dp*pi/3.0_dp*shape%radius**3
    case (shape_cylinder)
      volume = pi*shape%radius**2*height
    case (shape_ring)
      volume = pi*(shape%outer_radius**2 - shape%inner_radius**2)*height
    case (shape_polygon)
      volume = abs(signed_area(shape%vertices))
    end select
  end function shape_volume

  !> Area of a polygon, positive when its vertices run counter-clockwise
  pure real(dp) function signed_area(vertices) result(area)
    real(dp), intent(in) :: vertices(:, :)
    real(dp) :: a(2), b(2)
    integer :: k
    area = 0.0_dp
    do k = 1, size(vertices, 2) ! about the first vertex, so that a far origin costs no digits
      a = vertices(:, k) - vertices(:, 1)
      b = vertices(:, modulo(k, size(vertices, 2)) + 1) - vertices(:, 1)
      area = area + 0.5_dp*(a(1)*b(2) - a(2)*b(1))
    end do
  end function signed_area

  !> The point about which a body turns unless the scene says otherwise: centre, middle of the box, centroid; cuts ignored
  pure function shape_center(shape, dim) result(center)
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: dim
    real(dp) :: center(3)
    real(dp) :: a(2), b(2), cross
    integer :: k
    center = 0.0_dp
    select case (shape%kind)
    case (shape_box, shape_region)
      center(:dim) = 0.5_dp*(shape%lower(:dim) + shape%upper(:dim))
    case (shape_polygon)
      do k = 1, size(shape%vertices, 2)
        a = shape%vertices(:, k) - shape%vertices(:, 1)
        b = shape%vertices(:, modulo(k, size(shape%vertices, 2)) + 1) - shape%vertices(:, 1)
        cross = a(1)*b(2) - a(2)*b(1)
        center(1:2) = center(1:2) + (a + b)*cross
      end do
      center(1:2) = shape%vertices(:, 1) + center(1:2)/(6.0_dp*signed_area(shape%vertices))
    case (shape_none)
      continue
    case default
      center(:dim) = shape%center(:dim)
      if (dim == 3 .and. shape%kind /= shape_sphere .and. shape%axis_lower > -unbounded .and. shape%axis_upper < unbounded) &
        center(shape%axis) = 0.5_dp*(shape%axis_lower + shape%axis_upper)
    end select
  end function shape_center

  !> Box around the shape, cuts ignored; -+ `unbounded` along an axis without limits
  pure subroutine shape_bounds(shape, dim, lower, upper)
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: dim
    real(dp), intent(out) :: lower(3), upper(3)
    real(dp) :: radius
    lower = 0.0_dp
    upper = 0.0_dp
    select case (shape%kind)
    case (shape_box, shape_region)
      lower(:dim) = shape%lower(:dim)
      upper(:dim) = shape%upper(:dim)
    case (shape_polygon)
      lower(1:2) = minval(shape%vertices, dim=2)
      upper(1:2) = maxval(shape%vertices, dim=2)
    case (shape_none)
      continue
    case default
      radius = shape%radius
      if (shape%kind == shape_ring) radius = shape%outer_radius
      lower(:dim) = shape%center(:dim) - radius
      upper(:dim) = shape%center(:dim) + radius
      if (dim == 3 .and. shape%kind /= shape_sphere) then
        lower(shape%axis) = shape%axis_lower
        upper(shape%axis) = shape%axis_upper
      end if
    end select
  end subroutine shape_bounds

  !> Complain about a shape that holds nothing or does not fit the dimension
  pure subroutine check_shape(shape, dim, where, error)
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: dim
    character(len=*), intent(in) :: where !! begins each message, such as "&body 2 'left'"
    type(error_t), allocatable, intent(inout) :: error !! messages are added
    integer :: c
    select case (shape%kind)
    case (shape_box)
      if (.not. all(shape%upper(:dim) > shape%lower(:dim))) &
        call add_error(error, where//": upper must be above lower along every axis")
    case (shape_sphere, shape_cylinder)
      if (.not. shape%radius > 0.0_dp) &
        call add_error(error, where//": radius = "//text_of(shape%radius)//" m; must be above 0")
    case (shape_ring)
      if (.not. (shape%inner_radius >= 0.0_dp .and. shape%outer_radius > shape%inner_radius)) call add_error(error, where// &
        ": inner_radius = "//text_of(shape%inner_radius)//" m, outer_radius = "//text_of(shape%outer_radius) &
        //" m; must be 0 <= inner_radius < outer_radius")
    case (shape_polygon)
      call check_polygon(shape, dim, where, error)
    end select
    if (shape%kind == shape_cylinder .or. shape%kind == shape_ring) then
      if (dim == 1) call add_error(error, where//": shape needs dimension 2 or 3; in 1D use box")
      if (dim == 3 .and. .not. shape%axis_upper > shape%axis_lower) &
        call add_error(error, where//": axis_upper must be above axis_lower")
    end if
    do c = 1, shape%cuts
      if (.not. any(abs(shape%cut_normal(:dim, c)) > 0.0_dp)) &
        call add_error(error, where//": cut_normal of cut "//text_of(c)//" is zero; must point to the side taken away")
    end do
  end subroutine check_shape

  !> A polygon has at least three vertices, an area, and edges that do not cross
  pure subroutine check_polygon(shape, dim, where, error)
    type(shape_t), intent(in) :: shape
    integer, intent(in) :: dim
    character(len=*), intent(in) :: where
    type(error_t), allocatable, intent(inout) :: error
    integer :: n, i, j
    if (dim /= 2) call add_error(error, where//": shape = 'polygon' needs dimension 2")
    n = 0
    if (allocated(shape%vertices)) n = size(shape%vertices, 2)
    if (n < 3) then
      call add_error(error, where//": points holds "//text_of(n)//" vertices; a polygon has at least 3")
      return
    end if
    do i = 1, n - 1
      do j = i + 1, n
        if (.not. edges_cross(shape%vertices, i, j)) cycle
        call add_error(error, where//": the edges after vertices "//text_of(i)//" and "//text_of(j) &
          //" cross; list the vertices in order around the polygon")
        return
      end do
    end do
    if (.not. abs(signed_area(shape%vertices)) > 0.0_dp) call add_error(error, where//": the polygon has no area")
  end subroutine check_polygon

  !> Do the edges after vertices i and j cross properly? Edges that only touch do not.
  pure logical function edges_cross(vertices, i, j)
    real(dp), intent(in) :: vertices(:, :)
    integer, intent(in) :: i, j
    real(dp) :: a(2), b(2), c(2), d(2)
    a = vertices(:, i)
    b = vertices(:, modulo(i, size(vertices, 2)) + 1)
    c = vertices(:, j)
    d = vertices(:, modulo(j, size(vertices, 2)) + 1)
    edges_cross = turn(a, b, c)*turn(a, b, d) < 0.0_dp .and. turn(c, d, a)*turn(c, d, b) < 0.0_dp
  end function edges_cross

  !> 1 when a, b, c turn left, -1 when right, 0 when they lie on a line
  pure real(dp) function turn(a, b, c)
    real(dp), intent(in) :: a(2), b(2), c(2)
    real(dp) :: cross
    cross = (b(1) - a(1))*(c(2) - a(2)) - (b(2) - a(2))*(c(1) - a(1))
    turn = 0.0_dp
    if (abs(cross) > 0.0_dp) turn = sign(1.0_dp, cross)
  end function turn

end module gimp_shapes
