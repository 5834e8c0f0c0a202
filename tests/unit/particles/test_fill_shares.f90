!> Shares of a fill, one after the other, are the fill: every body, every particle, every bit
program test_fill_shares
  use gimp_kinds, only: wp, i8
  use gimp_error, only: error_t
  use gimp_text, only: text_of
  use gimp_shares, only: share_t
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use gimp_shapes, only: shape_box, shape_sphere, shape_ring
  use gimp_fill, only: fill_t, fill_body_t, fill_bodies, count_share, check_counts, fill_share
  implicit none(type, external)
  real(wp), parameter :: zero(3) = 0.0_wp

  call begin_suite("fill_shares")
  call lattices()
  call polar()
  call corners()
  call judged_together()
  call end_suite()

contains

  type(fill_body_t) function box(name, lower, upper, per_axis) result(body)
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: lower(3), upper(3)
    integer, intent(in) :: per_axis
    body%name = name
    body%shape%kind = shape_box
    body%shape%lower = lower
    body%shape%upper = upper
    body%particles_per_axis = per_axis
  end function box

  type(fill_body_t) function ball(name, center, radius, per_axis) result(body)
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: center(3), radius
    integer, intent(in) :: per_axis
    body%name = name
    body%shape%kind = shape_sphere
    body%shape%center = center
    body%shape%radius = radius
    body%particles_per_axis = per_axis
  end function ball

  !> Boxes, spheres and holes that overlap; a body from elsewhere; sheets of few planes, which more shares than planes must cut
  !> within a plane
  subroutine lattices()
    type(fill_body_t) :: hole, elsewhere
    hole = ball("hole", [0.8_wp, 0.7_wp, 0.6_wp], 0.35_wp, 1)
    hole%subtract = .true.
    elsewhere%name = "file"
    call compare("3D", 3, 0.2_wp, [10, 8, 6], [box("b", [0.2_wp, 0.2_wp, 0.1_wp], [1.1_wp, 1.0_wp, 1.2_wp], 2), elsewhere, &
      ball("s", [1.2_wp, 0.8_wp, 0.6_wp], 0.5_wp, 3), hole, box("last", spread(0.6_wp, 1, 3), spread(1.2_wp, 1, 3), 1)])
    call compare("2D", 2, 0.1_wp, [12, 12, 1], [box("first", zero, [0.6_wp, 1.2_wp, 0.0_wp], 2), hole, &
      ball("s", [0.6_wp, 0.6_wp, 0.0_wp], 0.5_wp, 3)])
    call compare("1D", 1, 0.125_wp, [16, 1, 1], [box("bar", zero, [0.5_wp, 0.0_wp, 0.0_wp], 2)])
    call compare("one plane", 3, 0.25_wp, [4, 4, 4], [box("sheet", zero, [0.25_wp, 1.0_wp, 1.0_wp], 1)])
    call compare("one particle", 3, 0.25_wp, [4, 4, 4], [box("dot", zero, spread(0.25_wp, 1, 3), 1)])
  end subroutine lattices

  subroutine polar()
    type(fill_body_t) :: ring
    integer :: k
    ring = ball("ring", [1.0_wp, 1.0_wp, 0.0_wp], 0.5_wp, 1)
    ring%shape%kind = shape_ring
    ring%shape%inner_radius = 0.3_wp
    ring%shape%outer_radius = 0.7_wp
    ring%polar = .true.
    ring%radial_particles = 3
    ring%angular_particles = 17
    do k = 1, 3
      ring%corners = k > 1
      ring%simplices = k > 2
      call compare("polar "//text_of(k), 2, 0.25_wp, [8, 8, 1], [box("b", zero, [0.75_wp, 1.0_wp, 0.0_wp], 2), ring])
    end do
  end subroutine polar

  !> Triangles and tetrahedra
  subroutine corners()
    type(fill_body_t) :: bodies(2)
    bodies = [ball("s", [0.9_wp, 0.7_wp, 0.6_wp], 0.5_wp, 1), box("b", zero, spread(0.8_wp, 1, 3), 2)]
    bodies%corners = .true.
    bodies%simplices = .true.
    call compare("triangles", 2, 0.2_wp, [8, 8, 1], bodies)
    call compare("tetrahedra", 3, 0.2_wp, [8, 8, 8], bodies)
  end subroutine corners

  !> One to seven shares against the one fill
  subroutine compare(what, dim, spacing, cells, bodies)
    character(len=*), intent(in) :: what
    integer, intent(in) :: dim, cells(3)
    real(wp), intent(in) :: spacing
    type(fill_body_t), intent(in) :: bodies(:)
    type(fill_t) :: whole, part
    type(error_t), allocatable :: error
    integer, allocatable :: outside(:)
    integer(i8) :: before(size(bodies))
    integer :: shares, k, b
    logical :: same
    call fill_bodies(dim, zero, spacing, cells, bodies, whole, error)
    call check_true(.not. allocated(error), what//": is filled")
    do shares = 1, 7
      before = 0
      same = .true.
      do k = 0, shares - 1
        call count_share(dim, zero, spacing, cells, bodies, share_t(k, shares), part, outside, error)
        call fill_share(dim, zero, spacing, cells, bodies, part)
        same = same .and. part%n == sum(part%count) .and. all(outside == 0)
        do b = 1, size(bodies)
          same = same .and. same_particles(whole, part, b, before(b))
        end do
        before = before + part%count
      end do
      call check_true(same, what//": "//text_of(shares)//" shares have the same particles")
      call check_true(sum(abs(before - whole%count)) == 0, what//": "//text_of(shares)//" shares have all particles")
    end do
  end subroutine compare

  !> Whether a share holds what the whole fill holds of a body after so many particles
  pure logical function same_particles(whole, part, b, before) result(same)
    type(fill_t), intent(in) :: whole, part
    integer, intent(in) :: b
    integer(i8), intent(in) :: before
    integer(i8) :: i, a, last
    i = part%first(b)
    last = i + part%count(b) - 1
    a = whole%first(b) + before
    same = before + part%count(b) <= whole%count(b)
    if (.not. same) return
    associate (z => a + part%count(b) - 1)
      same = all(part%position(:, i:last) == whole%position(:, a:z)) .and. all(part%volume(i:last) == whole%volume(a:z)) &
             .and. all(part%half_length(:, i:last) == whole%half_length(:, a:z)) &
             .and. all(part%faces(i:last) == whole%faces(a:z)) .and. (allocated(part%corner) .eqv. allocated(whole%corner))
      if (same .and. allocated(part%corner)) same = all(part%corner(:, :, i:last) == whole%corner(:, :, a:z))
    end associate
  end function same_particles

  !> A share without particles is no mistake, and one that sticks out is seen by its share alone
  subroutine judged_together()
    type(fill_t) :: part
    type(error_t), allocatable :: error
    type(fill_body_t) :: bodies(2)
    integer, allocatable :: outside(:)
    integer :: masks(2, 0:2)
    integer(i8) :: counts(2)
    integer :: k
    bodies = [box("off", [0.1_wp, 0.1_wp, 0.0_wp], [2.0_wp, 0.2_wp, 0.0_wp], 2), box("dot", [0.0_wp, 0.8_wp, 0.0_wp], [0.2_wp, 1.0_wp, 0.0_wp], 1)]
    counts = 0
    do k = 0, 2
      call count_share(2, zero, 0.2_wp, [6, 6, 1], bodies, share_t(k, 3), part, outside, error)
      call check_true(.not. allocated(error), "counting judges nothing")
      masks(:, k) = outside
      counts = counts + part%count
    end do
    call check_true(all(masks(1, :) == [0, 0, 2]), "only the last share of the first body sticks out")
    call check(int(counts(2)), 1, "the shares of the dot: one particle")
    call check_counts(2, zero, 0.2_wp, [6, 6, 1], .false., bodies, counts, ior(masks(:, 0), ior(masks(:, 1), masks(:, 2))), error)
    call check_true(allocated(error), "judged together")
    if (allocated(error)) call check(error%message, "&body 1 'off': reaches beyond the grid box at x_high; move it or enlarge &grid", &
      "only the body that sticks out is refused")
  end subroutine judged_together

end program test_fill_shares
