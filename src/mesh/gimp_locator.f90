!> What makes searching a mesh fast, built once: planes of the sides of elements, their centres, and buckets, boxes of a uniform grid that list
!> the elements that reach into them
module gimp_locator
  use gimp_kinds, only: wp, dp
  use gimp_mesh, only: mesh_t, hexahedron8, kind_nodes, kind_corners, kind_sides
  use gimp_sides, only: slack, most_sides, side_plane, ends_at_both
  implicit none(type, external)
  private
  public :: locator_t, make_locator, bucket_along

  !> What makes searching fast; built once
  type :: locator_t
    real(wp), allocatable :: plane(:, :, :, :) !! (dim + 1, part, side, element) unit vector into the element, and how far along it all is within
    real(wp), allocatable :: band(:, :) !! (side, element) the width between there and where all is without [cells]
    logical, allocatable :: both(:, :) !! (side, element) a point is without only if it is so for both parts of the side
    real(wp), allocatable :: centre(:, :) !! (dim, element) [cells]
    real(wp), allocatable :: reach(:) !! (element) the farthest corner from the centre, squared
    real(wp) :: low(3) = 0.0_wp, high(3) = 0.0_wp !! the box of all buckets [cells]
    real(wp) :: per_length(3) = 0.0_wp !! 1/edge of a bucket
    integer :: buckets(3) = 1
    integer, allocatable :: bucket_first(:), bucket_element(:) !! elements that reach into a bucket, the likeliest first
  end type locator_t

contains

  !> Build what searching needs, once the mesh is connected; time and memory in proportion to the number of elements
  subroutine make_locator(mesh, locator)
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(out) :: locator
    real(wp), allocatable :: box(:, :, :) !! (dim, low and high, element)
    real(wp) :: middle(3), outer
    integer :: dim, sides, parts, e, s, k, part
    dim = mesh%dim
    sides = size(mesh%across, 1)
    parts = merge(2, 1, any(mesh%kind == hexahedron8))
    allocate (locator%plane(dim + 1, parts, sides, mesh%elements), source=0.0_wp)
    allocate (locator%band(sides, mesh%elements), source=1.0_wp)
    allocate (locator%both(sides, mesh%elements), source=.false.)
    allocate (locator%centre(dim, mesh%elements), locator%reach(mesh%elements), box(dim, 2, mesh%elements))
    locator%plane(dim + 1, :, :, :) = -0.5_wp ! sides that other kinds have exclude nothing
    do e = 1, mesh%elements
      middle = 0.0_wp
      do k = 1, kind_corners(mesh%kind(e))
        middle(:dim) = middle(:dim) + mesh%x(:, mesh%node(k, e))/kind_corners(mesh%kind(e))
      end do
      locator%centre(:, e) = middle(:dim)
      locator%reach(e) = 0.0_wp
      do k = 1, kind_nodes(mesh%kind(e))
        locator%reach(e) = max(locator%reach(e), sum((mesh%x(:, mesh%node(k, e)) - middle(:dim))**2))
      end do
      call box_of_element(mesh, e, box(:, :, e))
      do s = 1, kind_sides(mesh%kind(e))
        do part = 1, parts
          call side_plane(mesh, e, s, part, locator%plane(:dim, part, s, e), locator%plane(dim + 1, part, s, e), outer)
        end do
        locator%band(s, e) = locator%plane(dim + 1, parts, s, e) - outer
        if (parts == 2) locator%both(s, e) = ends_at_both(mesh, e, s)
      end do
    end do
    call choose_buckets(mesh, box, locator)
    call fill_buckets(mesh, box, locator)
  end subroutine make_locator

  !> A box around an element, wider by what rounding asks for
  pure subroutine box_of_element(mesh, e, box)
    type(mesh_t), intent(in) :: mesh
    integer, intent(in) :: e
    real(wp), intent(out) :: box(mesh%dim, 2)
    real(wp) :: pole(2), margin
    integer :: k, s, corners
    corners = kind_corners(mesh%kind(e))
    box(:, 1) = mesh%x(:, mesh%node(1, e))
    box(:, 2) = mesh%x(:, mesh%node(1, e))
    do k = 2, corners
      box(:, 1) = min(box(:, 1), mesh%x(:, mesh%node(k, e)))
      box(:, 2) = max(box(:, 2), mesh%x(:, mesh%node(k, e)))
    end do
    if (kind_nodes(mesh%kind(e)) > corners .and. mesh%dim == 2) then ! a parabola stays within its control points
      do s = 1, corners
        k = 1 + modulo(s, corners)
        pole = 2.0_wp*mesh%x(1:2, mesh%node(corners + s, e)) - 0.5_wp*(mesh%x(1:2, mesh%node(s, e)) + mesh%x(1:2, mesh%node(k, e)))
        box(:, 1) = min(box(:, 1), pole)
        box(:, 2) = max(box(:, 2), pole)
      end do
    end if
    margin = 4.0_wp*slack + 8.0_wp*epsilon(1.0_wp)*maxval(abs(box))
    box(:, 1) = box(:, 1) - margin
    box(:, 2) = box(:, 2) + margin
  end subroutine box_of_element

  !> The size of buckets: half the mean size of elements, in space three quarters, and more where that would make too many or too long lists
  subroutine choose_buckets(mesh, box, locator)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: box(:, :, :)
    type(locator_t), intent(inout) :: locator
    real(wp) :: edge(mesh%dim)
    real(dp) :: listed, lists
    integer :: dim, e, d
    dim = mesh%dim
    locator%low(:dim) = minval(box(:, 1, :), 2)
    locator%high(:dim) = maxval(box(:, 2, :), 2)
    edge = merge(0.75_wp, 0.5_wp, dim == 3)*sum(box(:, 2, :) - box(:, 1, :), 2)/mesh%elements
    do
      if (product(1.0_dp + (locator%high(:dim) - locator%low(:dim))/edge) <= 16.0_dp*mesh%elements + 64.0_dp) then
        listed = 0.0_dp
        do e = 1, mesh%elements
          lists = 1.0_dp
          do d = 1, dim
            lists = lists*(2.0_dp + (box(d, 2, e) - box(d, 1, e))/edge(d))
          end do
          listed = listed + lists
        end do
        if (listed <= 80.0_dp*mesh%elements) exit
      end if
      edge = 1.25_wp*edge
    end do
    locator%buckets(:dim) = 1 + int((locator%high(:dim) - locator%low(:dim))/edge)
    locator%per_length(:dim) = 1.0_wp/edge
  end subroutine choose_buckets

  !> Note in every bucket which elements reach into it: count, sum, fill; then sort each list
  subroutine fill_buckets(mesh, box, locator)
    type(mesh_t), intent(in) :: mesh
    real(wp), intent(in) :: box(:, :, :)
    type(locator_t), intent(inout) :: locator
    integer, allocatable :: place(:)
    real(wp) :: rest(2, most_sides, 0:3)
    integer :: pass, e, d, first(3), last(3), i, j, k, bucket
    allocate (locator%bucket_first(product(locator%buckets) + 1), source=0)
    first = 0
    last = 0
    do pass = 1, 2
      do e = 1, mesh%elements
        do d = 1, mesh%dim
          first(d) = bucket_along(locator, d, box(d, 1, e))
          last(d) = bucket_along(locator, d, box(d, 2, e))
        end do
        rest(:, :, 3) = 0.0_wp
        do k = first(3), last(3)
          if (mesh%dim > 2) call add_axis(locator, e, box(:, :, e), 3, k, rest(:, :, 3), rest(:, :, 2))
          if (mesh%dim < 3) rest(:, :, 2) = 0.0_wp
          do j = first(2), last(2)
            if (mesh%dim > 1) call add_axis(locator, e, box(:, :, e), 2, j, rest(:, :, 2), rest(:, :, 1))
            if (mesh%dim < 2) rest(:, :, 1) = 0.0_wp
            do i = first(1), last(1)
              call add_axis(locator, e, box(:, :, e), 1, i, rest(:, :, 1), rest(:, :, 0))
              if (.not. reaches(locator, e, rest(:, :, 0))) cycle
              bucket = 1 + i + locator%buckets(1)*(j + locator%buckets(2)*k)
              if (pass == 1) then
                locator%bucket_first(bucket + 1) = locator%bucket_first(bucket + 1) + 1
              else
                locator%bucket_element(place(bucket)) = e
                place(bucket) = place(bucket) + 1
              end if
            end do
          end do
        end do
      end do
      if (pass == 2) exit
      locator%bucket_first(1) = 1
      do bucket = 2, size(locator%bucket_first)
        locator%bucket_first(bucket) = locator%bucket_first(bucket) + locator%bucket_first(bucket - 1)
      end do
      place = locator%bucket_first
      allocate (locator%bucket_element(place(size(place)) - 1))
    end do
    call sort_buckets(mesh, locator)
  end subroutine fill_buckets

  !> The largest n.x of the planes of element e within the part of a bucket that is in the box of the element: axis by axis
  pure subroutine add_axis(locator, e, box, d, at, before, after)
    type(locator_t), intent(in) :: locator
    integer, intent(in) :: e
    real(wp), intent(in) :: box(:, :) !! (dim, low and high)
    integer, intent(in) :: d, at !! the axis and the bucket along it
    real(wp), intent(in) :: before(2, most_sides) !! (part, side) what the other axes so far add up to
    real(wp), intent(out) :: after(2, most_sides)
    real(wp) :: low, high
    integer :: s, part
    low = max(box(d, 1), locator%low(d) + at/locator%per_length(d) - 4.0_wp*slack)
    high = min(box(d, 2), locator%low(d) + (at + 1)/locator%per_length(d) + 4.0_wp*slack)
    do s = 1, size(locator%plane, 3)
      do part = 1, size(locator%plane, 2)
        after(part, s) = before(part, s) + max(locator%plane(d, part, s, e)*low, locator%plane(d, part, s, e)*high)
      end do
    end do
  end subroutine add_axis

  !> May element e reach to where n.x is at most so much? Not if that is on the far side of one of its sides
  pure logical function reaches(locator, e, most)
    type(locator_t), intent(in) :: locator
    integer, intent(in) :: e
    real(wp), intent(in) :: most(2, most_sides) !! (part, side)
    integer :: s, parts, without
    parts = size(locator%plane, 2)
    reaches = .false.
    do s = 1, size(locator%plane, 3)
      without = count(most(:parts, s) < locator%plane(size(locator%plane, 1), :, s, e) - locator%band(s, e))
      if (without == parts .or. (without == 1 .and. .not. locator%both(s, e))) return
    end do
    reaches = .true.
  end function reaches

  !> Elements whose centres are near that of the bucket, measured by their size, come first
  pure subroutine sort_buckets(mesh, locator)
    type(mesh_t), intent(in) :: mesh
    type(locator_t), intent(inout) :: locator
    real(wp) :: middle(3), distance
    real(wp), allocatable :: distances(:)
    integer :: bucket, at(3), first, k, i, e
    allocate (distances(mesh%elements))
    do bucket = 1, size(locator%bucket_first) - 1
      at = [modulo(bucket - 1, locator%buckets(1)), modulo((bucket - 1)/locator%buckets(1), locator%buckets(2)), &
        (bucket - 1)/(locator%buckets(1)*locator%buckets(2))]
      middle(:mesh%dim) = locator%low(:mesh%dim) + (at(:mesh%dim) + 0.5_wp)/locator%per_length(:mesh%dim)
      first = locator%bucket_first(bucket)
      do k = first, locator%bucket_first(bucket + 1) - 1
        e = locator%bucket_element(k)
        distance = sum((middle(:mesh%dim) - locator%centre(:, e))**2)/locator%reach(e)
        do i = k - 1, first, -1 ! lists are short
          if (distances(1 + i - first) <= distance) exit
          distances(2 + i - first) = distances(1 + i - first)
          locator%bucket_element(i + 1) = locator%bucket_element(i)
        end do
        distances(2 + i - first) = distance
        locator%bucket_element(i + 1) = e
      end do
    end do
  end subroutine sort_buckets

  !> Which bucket along an axis, from 0
  pure integer function bucket_along(locator, d, x) result(at)
    type(locator_t), intent(in) :: locator
    integer, intent(in) :: d
    real(wp), intent(in) :: x !! within the box of buckets [cells]
    at = min(int((x - locator%low(d))*locator%per_length(d)), locator%buckets(d) - 1)
  end function bucket_along

end module gimp_locator
