!> Shapes: which points lie inside, exact volumes, centres, bounds, and what is refused
program test_shapes
  use gimp_kinds, only: wp, pi
  use gimp_error, only: error_t, report_lines
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use gimp_shapes, only: shape_t, inside, shape_volume, shape_center, shape_bounds, check_shape, unbounded, shape_words, &
    shape_box, shape_sphere, shape_cylinder, shape_ring, shape_polygon, shape_none
  use gimp_text, only: word_in
  implicit none(type, external)

  call begin_suite("shapes")
  call boundaries()
  call polygons()
  call cuts()
  call measured_volumes()
  call centers_and_bounds()
  call refusals()
  call end_suite()

contains

  !> Points on a boundary, and next to it, fall where the rules say, whatever the rounding
  subroutine boundaries()
    type(shape_t) :: s, next
    integer :: k
    real(wp) :: x(3)
    call check(word_in("polygon", shape_words), shape_polygon, "the words and the constants agree")
    call check(word_in("file", shape_words), shape_none, "a file has no shape")
    s%kind = shape_box
    s%upper = 1.0_wp
    call check_true(inside(s, 3, [0.0_wp, 0.0_wp, 0.0_wp]), "box: lower corner in")
    call check_true(.not. inside(s, 3, [0.5_wp, 0.5_wp, 1.0_wp]), "box: upper face out")
    call check_true(inside(s, 2, [0.5_wp, 0.5_wp, 7.0_wp]), "box: the third coordinate is not asked in 2D")
    ! two boxes side by side share no point and lose none, also at faces that are not binary fractions
    next = s
    do k = 1, 50
      s%upper(1) = 0.1_wp*k
      next%lower(1) = 0.1_wp*k
      next%upper(1) = 1.0e3_wp
      x = [k/10.0_wp*(1.0_wp + 4.0_wp*(modulo(k, 3) - 1)*epsilon(1.0_wp)), 0.5_wp, 0.5_wp]
      call check_true(inside(s, 3, x) .neqv. inside(next, 3, x), "boxes side by side: a point on the face is in one")
    end do
    s = shape_t(kind=shape_sphere, center=[3.0_wp, -2.0_wp, 0.0_wp], radius=0.5_wp)
    call check_true(inside(s, 2, [3.3_wp, -1.6_wp, 0.0_wp]), "sphere: a point at the radius is in (3, 4, 5)")
    call check_true(inside(s, 2, [2.7_wp, -2.4_wp, 0.0_wp]), "sphere: so is its mirror image")
    call check_true(.not. inside(s, 2, [3.3_wp, -1.6_wp + 1.0e-9_wp, 0.0_wp]), "sphere: a point beyond it is out")
    s = shape_t(kind=shape_ring, inner_radius=0.5_wp, outer_radius=1.0_wp)
    call check_true(inside(s, 2, [0.3_wp, 0.4_wp, 0.0_wp]) .and. inside(s, 2, [0.6_wp, 0.8_wp, 0.0_wp]), "ring: both radii in")
    call check_true(.not. inside(s, 2, [0.1_wp, 0.4_wp, 0.0_wp]), "ring: the hole is out")
    s = shape_t(kind=shape_cylinder, center=[9.0_wp, 1.0_wp, 1.0_wp], radius=1.0_wp, axis=1, axis_lower=0.0_wp, &
      axis_upper=2.0_wp)
    call check_true(inside(s, 3, [0.0_wp, 1.6_wp, 1.8_wp]), "cylinder about x: base in, radius in")
    call check_true(.not. inside(s, 3, [2.0_wp, 1.0_wp, 1.0_wp]), "cylinder about x: top out")
    s%axis_lower = -unbounded
    call check_true(inside(s, 3, [-1.0e6_wp, 1.0_wp, 1.0_wp]), "cylinder without lower end")
    call check_true(.not. inside(s, 3, [2.1_wp, 1.0_wp, 1.0_wp]), "cylinder without lower end has an upper one")
    s%kind = shape_none
    call check_true(.not. inside(s, 3, [1.0_wp, 1.0_wp, 1.0_wp]), "no shape, no points")
  end subroutine boundaries

  !> A concave polygon in either sense; polygons that share an edge share no point
  subroutine polygons()
    type(shape_t) :: s, left, right
    integer :: i, j, both, none
    real(wp) :: x(3)
    s%kind = shape_polygon
    s%vertices = reshape([0.0_wp, 0.0_wp, 3.0_wp, 0.0_wp, 3.0_wp, 3.0_wp, 2.0_wp, 3.0_wp, 2.0_wp, 1.0_wp, 1.0_wp, 1.0_wp, &
      1.0_wp, 3.0_wp, 0.0_wp, 3.0_wp], [2, 8]) ! the letter U
    call check_true(inside(s, 2, [0.5_wp, 2.5_wp, 0.0_wp]) .and. inside(s, 2, [2.5_wp, 1.0_wp, 0.0_wp]) .and. &
      inside(s, 2, [1.5_wp, 0.5_wp, 0.0_wp]), "U: legs and base in")
    call check_true(.not. inside(s, 2, [1.5_wp, 2.0_wp, 0.0_wp]), "U: between the legs out")
    call check(shape_volume(s, 2), 7.0_wp, 1.0e-14_wp, "U: area")
    call check(shape_center(s, 2), [1.5_wp, (3.0_wp*0.5_wp + 4.0_wp*2.0_wp)/7.0_wp, 0.0_wp], 1.0e-14_wp, "U: centroid")
    s%vertices = s%vertices(:, 8:1:-1)
    call check_true(inside(s, 2, [0.5_wp, 2.5_wp, 0.0_wp]) .and. .not. inside(s, 2, [1.5_wp, 2.0_wp, 0.0_wp]), "U, clockwise")
    call check(shape_volume(s, 2), 7.0_wp, 1.0e-14_wp, "U, clockwise: area")
    left%kind = shape_polygon
    right%kind = shape_polygon
    left%vertices = reshape([0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, 0.3_wp, 0.9_wp, 0.0_wp, 0.9_wp], [2, 4])
    right%vertices = reshape([1.0_wp, 0.9_wp, 0.3_wp, 0.9_wp, 1.0_wp, 0.0_wp], [2, 3])
    both = 0
    none = 0
    do i = 0, 99
      do j = 0, 89
        x = [0.01_wp*i, 0.01_wp*j, 0.0_wp] ! many of them on the common edge
        if (inside(left, 2, x) .and. inside(right, 2, x)) both = both + 1
        if (.not. inside(left, 2, x) .and. .not. inside(right, 2, x)) none = none + 1
      end do
    end do
    call check(both, 0, "polygons with a common edge: no point in both")
    call check(none, 0, "polygons with a common edge: no point lost between them")
  end subroutine polygons

  !> Cuts keep the side from which the normal points away, and the plane
  subroutine cuts()
    type(shape_t) :: s
    s = shape_t(kind=shape_sphere, radius=1.0_wp)
    s%cuts = 2
    s%cut_point(:, 1) = [0.5_wp, 0.0_wp, 0.0_wp]
    s%cut_normal(:, 1) = [2.0_wp, 0.0_wp, 0.0_wp]
    s%cut_normal(:, 2) = [0.0_wp, -1.0_wp, 0.0_wp]
    call check_true(inside(s, 3, [0.5_wp, 0.1_wp, 0.2_wp]), "cut: a point on the plane stays")
    call check_true(.not. inside(s, 3, [0.51_wp, 0.1_wp, 0.2_wp]), "cut: beyond the first plane")
    call check_true(.not. inside(s, 3, [0.4_wp, -0.1_wp, 0.2_wp]), "cut: beyond the second plane")
    call check(shape_volume(s, 3), -1.0_wp, 0.0_wp, "cut: no closed form for the volume")
  end subroutine cuts

  !> Closed forms against counting points of a fine lattice; tolerance: surface layer of one lattice step, half of it at most
  subroutine measured_volumes()
    type(shape_t) :: s
    s = shape_t(kind=shape_sphere, center=[0.02_wp, -0.03_wp, 0.01_wp], radius=0.9_wp)
    call check(counted(s, 1), shape_volume(s, 1), 0.02_wp, "1D sphere: 2 R")
    call check(shape_volume(s, 1), 1.8_wp, 1.0e-15_wp, "1D sphere")
    call check(counted(s, 2), shape_volume(s, 2), 0.01_wp, "2D sphere: pi R^2")
    call check(counted(s, 3), shape_volume(s, 3), 0.02_wp, "3D sphere: 4/3 pi R^3")
    s = shape_t(kind=shape_ring, inner_radius=0.4_wp, outer_radius=0.9_wp, axis=2, axis_lower=-0.5_wp, axis_upper=0.75_wp)
    call check(counted(s, 2), shape_volume(s, 2), 0.01_wp, "2D ring")
    call check(counted(s, 3), shape_volume(s, 3), 0.03_wp, "3D ring about y")
    s = shape_t(kind=shape_cylinder, radius=0.5_wp, axis=1, axis_lower=-0.9_wp, axis_upper=0.6_wp)
    call check(counted(s, 2), shape_volume(s, 2), 0.01_wp, "2D cylinder: a disk")
    call check(counted(s, 3), shape_volume(s, 3), 0.03_wp, "3D cylinder about x")
    call check(shape_volume(s, 3), 0.375_wp*pi, 1.0e-15_wp, "3D cylinder")
    s%axis_upper = unbounded
    call check(shape_volume(s, 3), -1.0_wp, 0.0_wp, "cylinder without upper end: no volume")
    s = shape_t(kind=shape_box, lower=[-0.5_wp, -0.25_wp, 0.0_wp], upper=[0.5_wp, 0.75_wp, 0.8_wp])
    call check(counted(s, 3), shape_volume(s, 3), 0.02_wp, "3D box")
  end subroutine measured_volumes

  !> Volume of a shape within the cube -1 to 1, by counting points 0.02 apart (0.005 in 2D)
  real(wp) function counted(s, dim)
    type(shape_t), intent(in) :: s
    integer, intent(in) :: dim
    integer :: n(3), i, j, k, hits
    n = 1
    n(:dim) = 400/merge(4, 1, dim == 3)
    hits = 0
    do i = 1, n(1)
      do j = 1, n(2)
        do k = 1, n(3)
          if (inside(s, dim, (2*[i, j, k] - 1.0_wp)/n - 1.0_wp)) hits = hits + 1
        end do
      end do
    end do
    counted = hits*(2.0_wp/n(1))**dim
  end function counted

  subroutine centers_and_bounds()
    type(shape_t) :: s
    real(wp) :: low(3), high(3)
    s = shape_t(kind=shape_box, lower=[1.0_wp, 2.0_wp, 3.0_wp], upper=[2.0_wp, 4.0_wp, 9.0_wp])
    call check(shape_center(s, 2), [1.5_wp, 3.0_wp, 0.0_wp], 0.0_wp, "box: centre in 2D")
    s = shape_t(kind=shape_cylinder, center=[1.0_wp, 2.0_wp, 3.0_wp], radius=0.5_wp, axis=2, axis_lower=4.0_wp, &
      axis_upper=6.0_wp)
    call check(shape_center(s, 3), [1.0_wp, 5.0_wp, 3.0_wp], 0.0_wp, "cylinder about y: middle of its height")
    call shape_bounds(s, 3, low, high)
    call check([low, high], [0.5_wp, 4.0_wp, 2.5_wp, 1.5_wp, 6.0_wp, 3.5_wp], 0.0_wp, "cylinder about y: bounds")
    s%kind = shape_ring
    s%outer_radius = 2.0_wp
    call shape_bounds(s, 2, low, high)
    call check([low(:2), high(:2)], [-1.0_wp, 0.0_wp, 3.0_wp, 4.0_wp], 0.0_wp, "ring in 2D: bounds")
  end subroutine centers_and_bounds

  subroutine refusals()
    type(shape_t) :: s
    type(error_t), allocatable :: error
    s = shape_t(kind=shape_box, lower=[0.0_wp, 1.0_wp, 0.0_wp], upper=[1.0_wp, 1.0_wp, 0.0_wp])
    call check_shape(s, 2, "&body 1 'a'", error)
    call check(error%message, "&body 1 'a': upper must be above lower along every axis", "flat box")
    s = shape_t(kind=shape_polygon)
    s%vertices = reshape([0.0_wp, 0.0_wp, 1.0_wp, 1.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, 1.0_wp], [2, 4])
    call check_shape(s, 2, "&body 2 'bow tie'", error)
    call check(report_lines(error), 2, "a second mistake is added to the first")
    call check_true(index(error%message, "edges after vertices 1 and 3 cross") > 0, "crossing edges are named")
    deallocate (error)
    s%vertices = reshape([0.0_wp, 0.0_wp, 1.0_wp, 1.0_wp, 1.0_wp, 0.0_wp], [2, 3])
    call check_shape(s, 2, "x", error)
    call check_true(.not. allocated(error), "a triangle is fine")
    call check_shape(s, 3, "x", error)
    call check_true(allocated(error), "polygon in 3D")
    deallocate (error)
    s = shape_t(kind=shape_ring, inner_radius=2.0_wp, outer_radius=1.0_wp, cuts=1)
    call check_shape(s, 1, "x", error)
    call check(report_lines(error), 3, "ring: radii the wrong way round, in 1D, with a cut without direction")
    deallocate (error)
    s = shape_t(kind=shape_sphere)
    call check_shape(s, 1, "x", error)
    call check_true(index(error%message, "radius = 0 m; must be above 0") > 0, "sphere without radius")
  end subroutine refusals

end program test_shapes
