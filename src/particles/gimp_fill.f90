!> Bodies become particles.
!>
!> Cartesian fill: particles sit at the centres of equal parts of the background cells, x = lower + (cell + (k - 1/2)/n) h,
!> where that centre lies in the body; V0 = prod h/n, half lengths h/(2n). Order: body by body, within a body by coordinate,
!> last axis fastest. Polar fill (2D ring or sphere): rings of equal width cut into equal angles; a particle sits at the mid
!> radius of its sector, where V0 = r dr dtheta is the exact area; radius by radius from the inside, then by angle.
!>
!> Where the corners of domains are wanted, a sector is the quadrilateral between its four corners, whose centroid and area the
!> particle has: domains tile the body. Parts of cells and sectors may be cut into triangles or tetrahedra (Kuhn 1960: one for each
!> order of the axes), a particle each at the centroid. Neighbours get the same numbers for the corners they share.
!>
!> A region that comes in pieces, such as the elements of a mesh, has a particle at the centroid of each piece.
!>
!> Who owns a point: a later body takes only what no earlier one holds; `subtract` carves all bodies above it in the list,
!> and what it frees is open to bodies below it.
!>
!> Shares: each of several fills its own rows of a lattice (sectors of a polar fill), of every body. What the shares of a body hold
!> is, one after the other, what one fill of it holds, bit for bit.
module gimp_fill
  use gimp_kinds, only: dp, i8, pi
  use gimp_error, only: error_t, add_error
  use gimp_text, only: text_of
  use gimp_shares, only: share_t, items_of_share
  use gimp_shapes, only: shape_t, inside, shape_bounds, check_shape, shape_none, shape_ring, shape_sphere, shape_region, unbounded
  use gimp_pieces, only: box_triangles, box_tetrahedra, simplex_content, quadrilateral_area, quadrilateral_centroid
  implicit none(type, external)
  private
  public :: fill_t, fill_body_t, fill_bodies, count_share, check_counts, fill_share
  public :: face_x_low, face_x_high, face_y_low, face_y_high, face_z_low, face_z_high

  !> Bits of `faces`, as for btest
  integer, parameter :: face_x_low = 0, face_x_high = 1, face_y_low = 2, face_y_high = 3, face_z_low = 4, face_z_high = 5
  character(len=*), parameter :: side_names(0:5) = ["x_low ", "x_high", "y_low ", "y_high", "z_low ", "z_high"]

  !> A body as the fill sees it
  type :: fill_body_t
    character(len=32) :: name = ""
    type(shape_t) :: shape !! kind `shape_none`: particles come from elsewhere, nothing is filled or claimed here
    logical :: subtract = .false. !! carves the bodies above it instead of adding material
    integer :: particles_per_axis(3) = 2 !! per cell; a region knows its pieces
    logical :: polar = .false. !! polar instead of Cartesian fill
    integer :: radial_particles = 0, angular_particles = 0 !! polar fill
    logical :: corners = .false. !! of domains are wanted (those of a Cartesian fill are boxes and not kept)
    logical :: simplices = .false. !! cut into triangles or tetrahedra; with `corners`
  end type fill_body_t

  !> The particles of all bodies, in the order of the bodies; or a share of those of each body
  type :: fill_t
    type(share_t) :: share
    integer(i8) :: n = 0
    real(dp), allocatable :: position(:, :) !! (dim, n) absolute [m]
    real(dp), allocatable :: volume(:) !! (n) [m3; per unit thickness in 2D]
    real(dp), allocatable :: half_length(:, :) !! (dim, n) [m]; polar: of the square with the area of the sector; pieces: of the box around, scaled
    integer, allocatable :: faces(:) !! (n) bit mask: no particle of the same body next to it there; polar fill, simplices and pieces: 0
    real(dp), allocatable :: corner(:, :, :) !! (dim, corners, n) of domains [m], if some body keeps them
    logical, allocatable :: keeps(:) !! (bodies) it keeps the corners of its domains
    integer(i8), allocatable :: first(:), count(:) !! (bodies) where a body starts here, and how many particles it has here
  end type fill_t

  !> Grid points at which one body may have particles
  type :: lattice_t
    integer :: dim = 0
    integer :: first(3) = 1, last(3) = 1 !! may include one layer outside the grid box, to notice what sticks out
    integer :: points(3) = 1 !! points of the whole grid box along each axis
    real(dp) :: x(3) = 0.0_dp !! lower corner of the grid box [m]
    real(dp) :: spacing = 0.0_dp !! of the background grid [m]
    integer :: per_axis(3) = 1 !! particles per cell
  end type lattice_t

contains

  !> Fill all bodies; tells every mistake at once
  subroutine fill_bodies(dim, lower, spacing, cells, bodies, result, error)
    integer, intent(in) :: dim
    real(dp), intent(in) :: lower(3) !! lower corner of the grid box [m]
    real(dp), intent(in) :: spacing !! of the background grid [m]
    integer, intent(in) :: cells(3) !! of the grid box along each axis
    type(fill_body_t), intent(in) :: bodies(:)
    type(fill_t), intent(out) :: result
    type(error_t), allocatable, intent(out) :: error
    integer, allocatable :: outside(:)
    call count_share(dim, lower, spacing, cells, bodies, share_t(), result, outside, error)
    if (.not. allocated(error)) call check_counts(dim, lower, spacing, cells, .false., bodies, result%count, outside, error)
    if (.not. allocated(error)) call fill_share(dim, lower, spacing, cells, bodies, result)
  end subroutine fill_bodies

  !> Count a share of the particles of each body, once the bodies are found sound (the same for all shares). Whether a body has
  !> particles and stays in the box can be judged when the shares are put together: `check_counts`.
  subroutine count_share(dim, lower, spacing, cells, bodies, share, result, outside, error)
    integer, intent(in) :: dim, cells(3)
    real(dp), intent(in) :: lower(3), spacing !! as of `fill_bodies`
    type(fill_body_t), intent(in) :: bodies(:)
    type(share_t), intent(in) :: share
    type(fill_t), intent(out) :: result !! counts only
    integer, allocatable, intent(out) :: outside(:) !! (bodies) bit mask of the sides where a body sticks out of the grid box
    type(error_t), allocatable, intent(out) :: error
    integer :: b
    result%share = share
    result%keeps = bodies%corners .and. (bodies%polar .or. bodies%simplices .or. bodies%shape%kind == shape_region)
    allocate (result%first(size(bodies)), result%count(size(bodies)), source=0_i8)
    allocate (outside(size(bodies)), source=0)
    do b = 1, size(bodies)
      call check_body(bodies(b), b, dim, error)
    end do
    if (allocated(error)) return
    call visit_bodies(dim, lower, spacing, cells, bodies, .false., result, outside)
  end subroutine count_share

  !> Fill the share that was counted
  subroutine fill_share(dim, lower, spacing, cells, bodies, result)
    integer, intent(in) :: dim, cells(3)
    real(dp), intent(in) :: lower(3), spacing !! as of `fill_bodies`
    type(fill_body_t), intent(in) :: bodies(:)
    type(fill_t), intent(inout) :: result
    integer :: outside(size(bodies))
    associate (n => result%n)
      allocate (result%position(dim, n), result%volume(n), result%half_length(dim, n), result%faces(n))
      if (any(result%keeps)) &
        allocate (result%corner(dim, merge(dim + 1, 2**dim, any(bodies%simplices)), n), source=0.0_dp)
    end associate
    outside = 0
    call visit_bodies(dim, lower, spacing, cells, bodies, .true., result, outside)
  end subroutine fill_share

  !> Count or fill a share of all bodies
  subroutine visit_bodies(dim, lower, spacing, cells, bodies, fill, result, outside)
    integer, intent(in) :: dim, cells(3)
    real(dp), intent(in) :: lower(3), spacing !! as of `fill_bodies`
    type(fill_body_t), intent(in) :: bodies(:)
    logical, intent(in) :: fill !! store the particles, not only count them
    type(fill_t), intent(inout) :: result
    integer, intent(inout) :: outside(:)
    integer, allocatable :: rivals(:)
    type(lattice_t) :: lattice
    integer(i8) :: n
    integer :: b
    n = 0
    do b = 1, size(bodies)
      if (bodies(b)%subtract .or. bodies(b)%shape%kind == shape_none) cycle
      result%first(b) = n + 1
      call list_rivals(bodies, b, dim, rivals)
      if (bodies(b)%shape%kind == shape_region) then
        call fill_region(bodies, b, rivals, dim, fill, result, n)
      else if (bodies(b)%polar) then
        call fill_polar(bodies, b, rivals, lower, lower + spacing*cells, fill, result, n, outside(b))
      else
        call lay_lattice(bodies(b), dim, lower, spacing, cells, lattice)
        call fill_lattice(bodies, b, rivals, lattice, fill, result, n, outside(b))
      end if
      result%count(b) = n - result%first(b) + 1
    end do
    result%n = n
  end subroutine visit_bodies

  !> The grid points near a body, with one layer outside the box where the body may reach it
  pure subroutine lay_lattice(body, dim, lower, spacing, cells, lattice)
    type(fill_body_t), intent(in) :: body
    integer, intent(in) :: dim, cells(3)
    real(dp), intent(in) :: lower(3), spacing
    type(lattice_t), intent(out) :: lattice
    real(dp) :: low(3), high(3), step
    integer :: d
    call shape_bounds(body%shape, dim, low, high)
    lattice%dim = dim
    lattice%x = lower
    lattice%spacing = spacing
    do d = 1, dim
      lattice%per_axis(d) = body%particles_per_axis(d)
      lattice%points(d) = cells(d)*body%particles_per_axis(d)
      step = spacing/body%particles_per_axis(d)
      ! clip before dividing: the bounds may be the largest number there is. A point more on each side costs nothing.
      lattice%first(d) = floor((min(max(low(d), lower(d) - step), lower(d) + spacing*cells(d)) - lower(d))/step)
      lattice%last(d) = ceiling((max(min(high(d), lower(d) + spacing*cells(d) + step), lower(d)) - lower(d))/step) + 1
      lattice%first(d) = max(lattice%first(d), merge(1, 0, low(d) <= -unbounded))
      lattice%last(d) = min(lattice%last(d), lattice%points(d) + merge(0, 1, high(d) >= unbounded))
    end do
  end subroutine lay_lattice

  !> Coordinate of a lattice point
  pure real(dp) function coordinate(lattice, d, i) result(x)
    type(lattice_t), intent(in) :: lattice
    integer, intent(in) :: d, i !! axis, number of the point from 1 at the lower end of the grid box
    integer :: cell
    cell = (i - 1 + lattice%per_axis(d))/lattice%per_axis(d) - 1 ! rounds down also for the layer outside
    x = lattice%x(d) + (cell + (i - cell*lattice%per_axis(d) - 0.5_dp)/lattice%per_axis(d))*lattice%spacing
  end function coordinate

  !> Coordinate of the low end of the part of a cell around a lattice point
  pure real(dp) function low_end(lattice, d, i) result(x)
    type(lattice_t), intent(in) :: lattice
    integer, intent(in) :: d, i !! as of `coordinate`
    integer :: cell
    cell = (i - 1 + lattice%per_axis(d))/lattice%per_axis(d) - 1
    x = lattice%x(d) + (cell + (i - 1 - cell*lattice%per_axis(d))/real(lattice%per_axis(d), dp))*lattice%spacing
  end function low_end

  !> Which points of one plane belong to the body; points outside the grid box only set bits of `outside`
  pure subroutine ask_plane(bodies, b, rivals, lattice, i, belongs, outside)
    type(fill_body_t), intent(in) :: bodies(:)
    integer, intent(in) :: b, rivals(:)
    type(lattice_t), intent(in) :: lattice
    integer, intent(in) :: i !! number of the plane
    logical(1), intent(inout) :: belongs(lattice%first(3) - 1:, lattice%first(2) - 1:) !! false on entry
    integer, intent(inout) :: outside
    integer :: at(3), j, k, d
    real(dp) :: x(3)
    x = 0.0_dp
    x(1) = coordinate(lattice, 1, i)
    do j = lattice%first(2), lattice%last(2)
      if (lattice%dim > 1) x(2) = coordinate(lattice, 2, j)
      do k = lattice%first(3), lattice%last(3)
        if (lattice%dim > 2) x(3) = coordinate(lattice, 3, k)
        if (.not. owns(bodies, b, rivals, lattice%dim, x)) cycle
        at = [i, j, k]
        belongs(k, j) = all(at >= 1 .and. at <= lattice%points)
        if (belongs(k, j)) cycle
        do d = 1, lattice%dim
          if (at(d) < 1) outside = ibset(outside, 2*d - 2)
          if (at(d) > lattice%points(d)) outside = ibset(outside, 2*d - 1)
        end do
      end do
    end do
  end subroutine ask_plane

  !> One plane further: the plane here becomes the one before, the one after becomes the one here
  pure subroutine rotate_planes(before, here, after)
    logical(1), allocatable, intent(inout) :: before(:, :), here(:, :), after(:, :)
    logical(1), allocatable :: old(:, :)
    call move_alloc(before, old)
    call move_alloc(here, before)
    call move_alloc(after, here)
    call move_alloc(old, after)
  end subroutine rotate_planes

  !> Does the point belong to body b, once the other bodies have had their say?
  pure logical function owns(bodies, b, rivals, dim, x)
    type(fill_body_t), intent(in) :: bodies(:)
    integer, intent(in) :: b, rivals(:), dim
    real(dp), intent(in) :: x(3)
    owns = inside(bodies(b)%shape, dim, x)
    if (owns) owns = is_left(bodies, b, rivals, dim, x)
  end function owns

  !> Is a point of body b left to it by the other bodies?
  pure logical function is_left(bodies, b, rivals, dim, x) result(owns)
    type(fill_body_t), intent(in) :: bodies(:)
    integer, intent(in) :: b, rivals(:), dim
    real(dp), intent(in) :: x(3)
    logical :: taken
    integer :: r, a
    owns = .true.
    taken = .false.
    do r = 1, size(rivals)
      a = rivals(r)
      if (bodies(a)%subtract) then
        if (.not. inside(bodies(a)%shape, dim, x)) cycle
        taken = .false. ! carved out of the bodies above, so open again
        owns = a < b
        if (.not. owns) return
      else if (.not. taken) then
        taken = inside(bodies(a)%shape, dim, x)
      end if
    end do
    owns = .not. taken
  end function is_left

  !> Bodies that may own points of body b, in order: those that carve, and those that were there before; each only where its
  !> box overlaps that of b
  pure subroutine list_rivals(bodies, b, dim, rivals)
    type(fill_body_t), intent(in) :: bodies(:)
    integer, intent(in) :: b, dim
    integer, allocatable, intent(out) :: rivals(:)
    real(dp) :: low(3), high(3), other_low(3), other_high(3)
    integer :: a
    allocate (rivals(0))
    call shape_bounds(bodies(b)%shape, dim, low, high)
    do a = 1, size(bodies)
      if (a == b .or. bodies(a)%shape%kind == shape_none) cycle
      if (a > b .and. .not. bodies(a)%subtract) cycle
      call shape_bounds(bodies(a)%shape, dim, other_low, other_high)
      if (all(other_low(:dim) <= high(:dim) .and. low(:dim) <= other_high(:dim))) rivals = [rivals, a]
    end do
  end subroutine list_rivals

  !> Count or fill the sectors of a ring or disk
  pure subroutine fill_polar(bodies, b, rivals, lower, upper, fill, result, n, outside)
    type(fill_body_t), intent(in) :: bodies(:)
    integer, intent(in) :: b, rivals(:)
    real(dp), intent(in) :: lower(3), upper(3) !! corners of the grid box [m]
    logical, intent(in) :: fill
    type(fill_t), intent(inout) :: result
    integer(i8), intent(inout) :: n
    integer, intent(inout) :: outside
    real(dp) :: inner, outer, r, angle, width, opening, x(3)
    integer(i8) :: sectors(2), at
    integer :: i, j, d
    inner = 0.0_dp
    outer = bodies(b)%shape%radius
    if (bodies(b)%shape%kind == shape_ring) then
      inner = bodies(b)%shape%inner_radius
      outer = bodies(b)%shape%outer_radius
    end if
    width = (outer - inner)/bodies(b)%radial_particles
    opening = 2.0_dp*pi/bodies(b)%angular_particles
    x = 0.0_dp
    sectors = items_of_share(result%share, int(bodies(b)%radial_particles, i8)*bodies(b)%angular_particles)
    do at = sectors(1), sectors(2)
      i = 1 + int((at - 1)/bodies(b)%angular_particles)
      j = 1 + int(modulo(at - 1, int(bodies(b)%angular_particles, i8)))
      r = inner + (i - 0.5_dp)*width
      angle = (j - 0.5_dp)*opening
      x(1:2) = bodies(b)%shape%center(1:2) + r*[cos(angle), sin(angle)]
      if (.not. owns(bodies, b, rivals, 2, x)) cycle
      do d = 1, 2
        if (x(d) < lower(d)) outside = ibset(outside, 2*d - 2)
        if (x(d) > upper(d)) outside = ibset(outside, 2*d - 1)
      end do
      if (bodies(b)%corners) then
        call put_domain(bodies(b)%simplices, sector(), fill, result, n)
        cycle
      end if
      n = n + 1
      if (.not. fill) cycle
      result%position(:, n) = x(1:2)
      result%volume(n) = r*width*opening ! (r2^2 - r1^2)/2 dtheta for the mid radius r
      result%half_length(:, n) = 0.5_dp*sqrt(result%volume(n))
      result%faces(n) = 0
    end do

  contains

    !> Corners of the sector, the radius first
    pure function sector() result(box)
      real(dp) :: box(2, 4)
      integer :: a, ray
      do a = 1, 4
        ray = modulo(j - 1 + (a - 1)/2, bodies(b)%angular_particles)
        box(:, a) = bodies(b)%shape%center(1:2) &
                    + (inner + (i - 1 + modulo(a - 1, 2))*width)*[cos(ray*opening), sin(ray*opening)]
      end do
    end function sector

  end subroutine fill_polar

  !> Count or fill a share of the pieces of a region
  subroutine fill_region(bodies, b, rivals, dim, fill, result, n)
    type(fill_body_t), intent(in) :: bodies(:)
    integer, intent(in) :: b, rivals(:), dim
    logical, intent(in) :: fill
    type(fill_t), intent(inout) :: result
    integer(i8), intent(inout) :: n
    real(dp) :: corner(dim, 2**dim), content, x(3), extent(dim)
    integer(i8) :: pieces(2), piece
    integer :: corners
    x = 0.0_dp
    pieces = items_of_share(result%share, bodies(b)%shape%region%pieces())
    do piece = pieces(1), pieces(2)
      call bodies(b)%shape%region%piece(piece, corners, corner, content, x(:dim))
      if (.not. is_left(bodies, b, rivals, dim, x)) cycle
      n = n + 1
      if (.not. fill) cycle
      extent = maxval(corner(:, :corners), dim=2) - minval(corner(:, :corners), dim=2)
      result%position(:, n) = x(:dim)
      result%volume(n) = content
      result%half_length(:, n) = 0.5_dp*extent*(content/product(extent))**(1.0_dp/dim)
      result%faces(n) = 0
      if (bodies(b)%corners) result%corner(:, :, n) = corner(:, :corners)
    end do
  end subroutine fill_region

  !> Count or store the particle of a domain, or those of the simplices it is cut into
  pure subroutine put_domain(simplices, box, fill, result, n)
    logical, intent(in) :: simplices, fill
    real(dp), intent(in) :: box(:, :) !! (dim, 2^dim) corners, the first axis fastest [m]
    type(fill_t), intent(inout) :: result
    integer(i8), intent(inout) :: n !! particles so far
    integer :: piece
    if (.not. simplices) then
      call put_particle(box, quadrilateral_area(box), quadrilateral_centroid(box), fill, result, n)
    else if (size(box, 1) == 2) then
      do piece = 1, 2
        call put_simplex(box(:, box_triangles(:, piece)), fill, result, n)
      end do
    else
      do piece = 1, 6
        call put_simplex(box(:, box_tetrahedra(:, piece)), fill, result, n)
      end do
    end if
  end subroutine put_domain

  !> Count or store a simplex, unless it is flat, as some at the middle of a disk
  pure subroutine put_simplex(corner, fill, result, n)
    real(dp), intent(in) :: corner(:, :) !! (dim, dim + 1) [m]
    logical, intent(in) :: fill
    type(fill_t), intent(inout) :: result
    integer(i8), intent(inout) :: n
    real(dp) :: content
    content = simplex_content(corner)
    if (content > 0.0_dp) call put_particle(corner, content, sum(corner, dim=2)/size(corner, 2), fill, result, n)
  end subroutine put_simplex

  pure subroutine put_particle(corner, content, centroid, fill, result, n)
    real(dp), intent(in) :: corner(:, :), content, centroid(:) !! [m]
    logical, intent(in) :: fill
    type(fill_t), intent(inout) :: result
    integer(i8), intent(inout) :: n
    n = n + 1
    if (.not. fill) return
    result%position(:, n) = centroid
    result%volume(n) = content
    result%half_length(:, n) = 0.5_dp*content**(1.0_dp/size(centroid))
    result%faces(n) = 0
    result%corner(:, :, n) = corner
  end subroutine put_particle

  !> What can be said about a body before it is filled
  pure subroutine check_body(body, b, dim, error)
    type(fill_body_t), intent(in) :: body
    integer, intent(in) :: b, dim
    type(error_t), allocatable, intent(inout) :: error
    call check_shape(body%shape, dim, title_of(body, b), error)
    if (body%subtract .or. body%shape%kind == shape_none) return
    if (.not. body%polar) then
      if (any(body%particles_per_axis(:dim) < 1)) &
        call add_error(error, title_of(body, b)//": particles_per_axis must be at least 1")
      return
    end if
    if (dim /= 2 .or. (body%shape%kind /= shape_ring .and. body%shape%kind /= shape_sphere)) &
      call add_error(error, title_of(body, b)//": fill = 'polar' is for ring and sphere in 2D")
    if (body%radial_particles < 1 .or. body%angular_particles < 1) call add_error(error, title_of(body, b) &
      //": fill = 'polar' needs radial_particles and angular_particles, each at least 1")
  end subroutine check_body

  !> What can only be said after counting: each body must have particles and stay in the grid box
  subroutine check_counts(dim, lower, spacing, cells, is_mesh, bodies, count, outside, error)
    integer, intent(in) :: dim, cells(3)
    real(dp), intent(in) :: lower(3), spacing !! as of `fill_bodies`
    logical, intent(in) :: is_mesh !! the box is that around a mesh
    type(fill_body_t), intent(in) :: bodies(:)
    integer(i8), intent(in) :: count(:) !! (bodies) of all shares
    integer, intent(in) :: outside(:) !! (bodies) bit masks of all shares
    type(error_t), allocatable, intent(out) :: error
    character(len=:), allocatable :: sides, box, remedy
    real(dp) :: low(3), high(3), upper(3)
    integer :: b, k
    upper = lower + spacing*cells
    box = "the grid box"
    remedy = "; move it or enlarge &grid"
    if (is_mesh) box = "the box around the mesh"
    if (is_mesh) remedy = "; move it or make the mesh larger"
    do b = 1, size(bodies)
      if (bodies(b)%subtract .or. bodies(b)%shape%kind == shape_none) cycle
      call shape_bounds(bodies(b)%shape, dim, low, high)
      if (any(low(:dim) >= upper(:dim) .or. high(:dim) <= lower(:dim))) then
        call add_error(error, title_of(bodies(b), b)//": lies outside "//box//remedy)
      else if (outside(b) /= 0) then
        sides = ""
        do k = 0, 5
          if (btest(outside(b), k)) sides = sides//" "//trim(side_names(k))
        end do
        call add_error(error, title_of(bodies(b), b)//": reaches beyond "//box//" at"//sides//remedy)
      else if (count(b) == 0) then
        call add_error(error, title_of(bodies(b), b)//": no particle centre lies inside; it must be larger than the particle " &
          //"spacing and not wholly taken or carved away by other bodies")
      end if
    end do
  end subroutine check_counts

  !> How messages name a body
  pure function title_of(body, b) result(title)
    type(fill_body_t), intent(in) :: body
    integer, intent(in) :: b
    character(len=:), allocatable :: title
    title = "&body "//text_of(b)//" '"//trim(body%name)//"'"
  end function title_of

  !> Count or fill a share of the lattice points of a body: rows along the last axis, plane by plane along the first axis. Three
  !> planes are kept, so that the neighbours of a point are known and every point is asked once; the planes before and after those
  !> of the share are asked for their neighbours' sake.
  subroutine fill_lattice(bodies, b, rivals, lattice, fill, result, n, outside)
    type(fill_body_t), intent(in) :: bodies(:)
    integer, intent(in) :: b !! the body
    integer, intent(in) :: rivals(:) !! bodies that may own some of its points
    type(lattice_t), intent(in) :: lattice
    logical, intent(in) :: fill !! store the particles, not only count them
    type(fill_t), intent(inout) :: result
    integer(i8), intent(inout) :: n !! particles so far
    integer, intent(inout) :: outside !! bit mask of the sides where the body sticks out of the grid box
    logical(1), allocatable :: before(:, :), here(:, :), after(:, :) !! (last axis, second axis), with a rim of nothing
    integer(i8) :: rows(2)
    integer :: i, j, k, faces, across, begin(2), end(2) ! plane and row
    real(dp) :: volume, half(3)

    if (any(lattice%last < lattice%first)) return
    across = lattice%last(2) - lattice%first(2) + 1
    rows = items_of_share(result%share, int(lattice%last(1) - lattice%first(1) + 1, i8)*across)
    if (rows(2) < rows(1)) return
    begin = place_of_row(rows(1))
    end = place_of_row(rows(2))
    half = 0.5_dp*lattice%spacing/lattice%per_axis
    volume = product(2.0_dp*half(:lattice%dim))
    allocate (before(lattice%first(3) - 1:lattice%last(3) + 1, lattice%first(2) - 1:lattice%last(2) + 1), source=.false._1)
    here = before
    after = before
    if (begin(1) > lattice%first(1)) call ask_plane(bodies, b, rivals, lattice, begin(1) - 1, before, outside)
    call ask_plane(bodies, b, rivals, lattice, begin(1), here, outside)
    do i = begin(1), end(1)
      after = .false.
      if (i < lattice%last(1)) call ask_plane(bodies, b, rivals, lattice, i + 1, after, outside)
      do j = merge(begin(2), lattice%first(2), i == begin(1)), merge(end(2), lattice%last(2), i == end(1))
        do k = lattice%first(3), lattice%last(3)
          if (.not. here(k, j)) cycle
          if (bodies(b)%simplices) then
            call put_domain(.true., part_of_cell([i, j, k]), fill, result, n)
            cycle
          end if
          n = n + 1
          if (.not. fill) cycle
          faces = 0
          if (.not. before(k, j)) faces = ibset(faces, face_x_low)
          if (.not. after(k, j)) faces = ibset(faces, face_x_high)
          if (lattice%dim > 1 .and. .not. here(k, j - 1)) faces = ibset(faces, face_y_low)
          if (lattice%dim > 1 .and. .not. here(k, j + 1)) faces = ibset(faces, face_y_high)
          if (lattice%dim > 2 .and. .not. here(k - 1, j)) faces = ibset(faces, face_z_low)
          if (lattice%dim > 2 .and. .not. here(k + 1, j)) faces = ibset(faces, face_z_high)
          result%faces(n) = faces
          result%volume(n) = volume
          result%half_length(:, n) = half(:lattice%dim)
          result%position(1, n) = coordinate(lattice, 1, i)
          if (lattice%dim > 1) result%position(2, n) = coordinate(lattice, 2, j)
          if (lattice%dim > 2) result%position(3, n) = coordinate(lattice, 3, k)
        end do
      end do
      call rotate_planes(before, here, after)
    end do

  contains

    !> Numbers of a row on the first and the second axis
    pure function place_of_row(row) result(at)
      integer(i8), intent(in) :: row !! from 1
      integer :: at(2)
      at = lattice%first(:2) + [int((row - 1)/across), int(modulo(row - 1, int(across, i8)))]
    end function place_of_row

    !> Corners of the part of a cell that belongs to a lattice point, the first axis fastest
    pure function part_of_cell(at) result(box)
      integer, intent(in) :: at(3)
      real(dp) :: box(lattice%dim, 2**lattice%dim)
      integer :: a, d
      do a = 1, 2**lattice%dim
        do d = 1, lattice%dim
          box(d, a) = low_end(lattice, d, at(d) + merge(1, 0, btest(a - 1, d - 1)))
        end do
      end do
    end function part_of_cell

  end subroutine fill_lattice

end module gimp_fill
