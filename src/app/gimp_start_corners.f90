!> Where the corners of particle domains begin that move with the grid: on the lattice of the fill, where a file says, or where the
!> exact solution has them; neighbours of one lattice get the same numbers for the corners they share
module gimp_start_corners
  use gimp_kinds, only: wp, dp, i8, lanes
  use gimp_text, only: text_of
  use gimp_particle_file, only: particle_table_t
  use gimp_particles, only: particles_t
  use gimp_corner_domains, only: carried_simplex, on_raster, least_jacobian_1d, least_jacobian_2d, least_jacobian_3d, &
    place_corners_1d, place_corners_2d, place_corners_3d
  use gimp_verification, only: verification_t, exact_motion
  use gimp_engine, only: engine_t
  implicit none(type, external)
  private
  public :: box_at, store_corners, deform_corners, exact_corners, settle_corners, table_corner_fault, corners_in_cells

  real(dp), parameter :: on_lattice = 1.0e-6_dp !! of a lattice step: so near to a place of the lattice a corner is there

contains

  !> Corners of the box x +- half, numbered with the first axis fastest. Those on a lattice with whole numbers of boxes per cell are
  !> quotients of whole numbers, whichever neighbour asks.
  pure function box_at(d, x, half) result(corner)
    integer, intent(in) :: d
    real(dp), intent(in) :: x(d), half(d) !! from the corner of the grid box [cells]
    real(dp) :: corner(d, 2**d) !! [cells]
    real(dp) :: place, per
    integer :: a, k
    do k = 1, d
      per = anint(0.5_dp/half(k))
      do a = 1, 2**d
        corner(k, a) = x(k) + merge(half(k), -half(k), btest(a - 1, k - 1))
        place = corner(k, a)*per
        if (per > 0.0_dp .and. abs(place - anint(place)) < on_lattice .and. abs(0.5_dp/half(k) - per) < on_lattice) &
          corner(k, a) = anint(place)/per
      end do
    end do
  end function box_at

  !> From the order of meshes (quadrilaterals counter-clockwise, hexahedra bottom then top) to that of this program, and back
  pure function mesh_order(d, simplex) result(order)
    integer, intent(in) :: d
    logical, intent(in) :: simplex
    integer, allocatable :: order(:)
    integer :: a
    if (simplex) then
      order = [(a, a=1, d + 1)]
    else if (d == 1) then
      order = [1, 2]
    else
      order = [1, 2, 4, 3]
      if (d == 3) order = [order, 4 + order]
    end if
  end function mesh_order

  !> Put the corners of one particle
  pure subroutine store_corners(particles, l, c, corner)
    type(particles_t), intent(inout) :: particles
    integer, intent(in) :: l, c !! lane, chunk
    real(dp), intent(in) :: corner(:, :) !! (d, corners) from the corner of the grid box [cells]
    associate (q => particles%corner%first, n => particles%corner%components)
      particles%p(l, q:q + n - 1, c) = real(reshape(corner, [n]), wp)
    end associate
  end subroutine store_corners

  !> The corners of one particle
  pure function stored_corners(particles, l, c) result(corner)
    type(particles_t), intent(in) :: particles
    integer, intent(in) :: l, c
    real(dp), allocatable :: corner(:, :) !! (d, corners) [cells]
    associate (q => particles%corner%first, n => particles%corner%components, d => particles%dim)
      corner = reshape(real(particles%p(l, q:q + n - 1, c), dp), [d, n/d])
    end associate
  end function stored_corners

  !> Corners of one particle from those of its reference shape around the same place: x + F (X - x)
  pure subroutine deform_corners(particles, l, c, f)
    type(particles_t), intent(inout) :: particles
    integer, intent(in) :: l, c
    real(dp), intent(in) :: f(:) !! (d*d) row by row
    real(dp), allocatable :: corner(:, :)
    real(dp) :: x(3), matrix(particles%dim, particles%dim)
    integer :: a, d
    d = particles%dim
    x(:d) = real(particles%p(l, :d, c), dp)
    matrix = transpose(reshape(f(:d*d), [d, d]))
    corner = stored_corners(particles, l, c)
    do a = 1, size(corner, 2)
      corner(:, a) = x(:d) + matmul(matrix, corner(:, a) - x(:d))
    end do
    call store_corners(particles, l, c, corner)
  end subroutine deform_corners

  !> Corners of some lanes of a chunk as the exact solution moves them at t = 0
  subroutine exact_corners(engine, solution, c, mine)
    type(engine_t), intent(inout) :: engine
    type(verification_t), intent(in) :: solution
    integer, intent(in) :: c
    logical, intent(in) :: mine(lanes) !! which lanes
    real(dp) :: x(lanes, 3), u(lanes, 3), v(lanes, 3), f(lanes, 9)
    integer :: a, k, l, q
    associate (p => engine%particles%p, d => engine%grid%dim)
      do a = 1, engine%rule%n
        q = engine%particles%corner%first + d*(a - 1)
        x = 0.0_dp
        do k = 1, d
          x(:, k) = engine%grid%lower(k) + engine%grid%spacing*p(:, q + k - 1, c)
        end do
        l = findloc(mine, .true., dim=1)
        do k = 1, d
          where (.not. mine) x(:, k) = x(l, k)
        end do
        call exact_motion(solution, 0.0_dp, x, u, v, f)
        do k = 1, d
          where (mine) p(:, q + k - 1, c) = real(p(:, q + k - 1, c) + u(:, k)/engine%grid%spacing, wp)
        end do
      end do
    end associate
  end subroutine exact_corners

  !> Corners of a chunk on their raster, and the gradients of the reference shape, F^T g
  pure subroutine settle_corners(engine, c, f)
    type(engine_t), intent(inout) :: engine
    integer, intent(in) :: c
    real(wp), intent(in) :: f(lanes, 9)
    real(wp) :: volume(lanes), at(lanes, engine%grid%dim, engine%rule%n), by(lanes, engine%grid%dim, engine%rule%n)
    real(wp) :: share(lanes, engine%rule%n)
    integer :: a, i, k, q
    associate (p => engine%particles%p, corner => engine%particles%corner, d => engine%grid%dim, rule => engine%rule, &
               reference => engine%particles%reference_gradient)
      q = corner%first
      p(:, q:q + corner%components - 1, c) = on_raster(real(p(:, q:q + corner%components - 1, c), dp))
      p(:, engine%particles%detached%first, c) = 0.0_wp
      if (reference%first == 0) return
      select case (d)
      case (1); call place_corners_1d(rule%carried, rule%n, p(1, q, c), at, share, by, volume)
      case (2); call place_corners_2d(rule%carried, rule%n, p(1, q, c), at, share, by, volume)
      case (3); call place_corners_3d(rule%carried, rule%n, p(1, q, c), at, share, by, volume)
      end select
      do a = 1, rule%n
        do k = 1, d
          q = reference%first + d*(a - 1) + k - 1
          p(:, q, c) = 0.0_wp
          do i = 1, d
            p(:, q, c) = p(:, q, c) + f(:, 3*(i - 1) + k)*by(:, i, a)
          end do
        end do
      end do
    end associate
  end subroutine settle_corners

  !> The corners of a particle of a file in the order of this program
  pure function corners_in_cells(engine, given) result(corner)
    type(engine_t), intent(in) :: engine
    real(dp), intent(in) :: given(:) !! one after the other, in the order of meshes [m]
    real(dp) :: corner(engine%grid%dim, engine%rule%n) !! from the corner of the grid box [cells]
    integer :: a
    corner = reshape(given, shape(corner))
    corner = corner(:, mesh_order(engine%grid%dim, engine%rule%carried == carried_simplex))
    do a = 1, engine%rule%n
      corner(:, a) = (corner(:, a) - engine%grid%lower(:engine%grid%dim))/engine%grid%spacing
    end do
  end function corners_in_cells

  !> What is wrong with the corners of a particle of a file; empty if nothing is
  pure function table_corner_fault(engine, table, i) result(fault)
    type(engine_t), intent(in) :: engine
    type(particle_table_t), intent(in) :: table
    integer(i8), intent(in) :: i !! which of the table
    character(len=:), allocatable :: fault
    integer :: d
    d = engine%grid%dim
    fault = ""
    if (.not. allocated(table%corner)) then
      if (engine%rule%carried == carried_simplex) fault = "has no dataset corner, which particle_domain = 'simplex' needs"
    else if (size(table%corner, 1) /= d*engine%rule%n) then
      fault = "corner has "//text_of(size(table%corner, 1))//" numbers for a particle; particle_domain wants "//text_of(d*engine%rule%n)
    else
      fault = corner_fault(engine, (table%position(:, i) - engine%grid%lower(:d))/engine%grid%spacing, &
                           table%volume(i)/engine%grid%spacing**d, corners_in_cells(engine, table%corner(:, i)))
      if (fault /= "") fault = "the domain of particle "//text_of(table%first + i - 1)//" "//fault
    end if
  end function table_corner_fault

  !> What is wrong with corners that somebody gave; empty if nothing is
  pure function corner_fault(engine, x, volume, corner) result(fault)
    type(engine_t), intent(in) :: engine
    real(dp), intent(in) :: x(:), volume, corner(:, :) !! particle, its volume, (d, corners) in cells
    character(len=:), allocatable :: fault
    real(wp) :: chunk(lanes, size(corner, 1), size(corner, 2)), least(lanes), content(lanes)
    real(wp) :: at(lanes, size(corner, 1), size(corner, 2)), by(lanes, size(corner, 1), size(corner, 2)), share(lanes, size(corner, 2))
    integer :: l, n
    do l = 1, lanes
      chunk(l, :, :) = real(corner, wp)
    end do
    n = size(corner, 2)
    select case (size(corner, 1))
    case (1)
      call least_jacobian_1d(engine%rule%carried, n, chunk, least)
      call place_corners_1d(engine%rule%carried, n, chunk, at, share, by, content)
    case (2)
      call least_jacobian_2d(engine%rule%carried, n, chunk, least)
      call place_corners_2d(engine%rule%carried, n, chunk, at, share, by, content)
    case default
      call least_jacobian_3d(engine%rule%carried, n, chunk, least)
      call place_corners_3d(engine%rule%carried, n, chunk, at, share, by, content)
    end select
    fault = ""
    if (.not. least(1) > 0.0_wp) then
      fault = "is inverted: its corners must be in the order of meshes (quadrilaterals counter-clockwise, hexahedra bottom then top) " &
        //"and its angles below 180 degrees"
    else if (abs(log(real(content(1), dp)/volume)) > log(2.0_dp)) then
      fault = "has another content than its volume says"
    else if (any(sum((corner - spread(x, 2, n))**2, dim=1) > real(engine%longest_diagonal, dp)**2)) then
      fault = "has a corner farther from its position than domain_limit"
    end if
  end function corner_fault

end module gimp_start_corners
