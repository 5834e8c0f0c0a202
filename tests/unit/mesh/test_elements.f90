!> Elements: shape functions, their slopes, natural coordinates there and back, volumes, heights, and shapes that must be refused
program test_elements
  use gimp_kinds, only: wp
  use gimp_mesh, only: line2, triangle3, triangle6, quad4, quad8, quad9, tetrahedron4, hexahedron8, n_kinds, kind_name, kind_dim, &
    kind_nodes
  use gimp_elements, only: shape_values, shape_slopes, natural_coordinates, beyond, element_volume, element_height, smallest_jacobian, &
    jacobian
  use gimp_made_meshes, only: random_t, random_number_of
  use gimp_made_elements, only: natural_nodes, made_element, random_place
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  use, intrinsic :: ieee_exceptions, only: ieee_invalid, ieee_set_flag, ieee_set_halting_mode
  implicit none(type, external)

  type(random_t) :: random
  integer :: kind

  call begin_suite("elements")
  do kind = 1, n_kinds
    call test_functions(kind)
    call test_there_and_back(kind, 0.0_wp, 0.9_wp, 1.0_wp, 1.0e-13_wp, "parallelogram")
    call test_there_and_back(kind, 0.3_wp, 0.2_wp, 1.0_wp, 1.0e-12_wp, "30 % distorted")
    call test_there_and_back(kind, 0.45_wp, 0.03_wp, 10.0_wp, 1.0e-12_wp, "strongly distorted")
    call test_outside(kind)
    call test_measures(kind)
    call test_bad(kind)
  end do
  call test_known_pairs()
  call test_special_quads()
  call test_curved_volume()
  call test_hexahedra()
  call end_suite()

contains

  !> 1 at one's own node, sum 1, slopes sum to 0 and equal differences (central, h = 1e-5: h^2 + eps/h = 1e-10); linear fields
  subroutine test_functions(kind)
    integer, intent(in) :: kind
    real(wp), parameter :: h = 1.0e-5_wp
    real(wp) :: n(kind_nodes(kind)), below(kind_nodes(kind)), above(kind_nodes(kind)), node(kind_dim(kind), kind_nodes(kind))
    real(wp) :: dn(kind_dim(kind), kind_nodes(kind)), xi(kind_dim(kind)), h_k(kind_dim(kind)), worst(5)
    integer :: i, k, trial
    node = natural_nodes(kind)
    worst = 0.0_wp
    do i = 1, kind_nodes(kind)
      call shape_values(kind, node(:, i), n)
      n(i) = n(i) - 1.0_wp
      worst(1) = max(worst(1), maxval(abs(n)))
    end do
    do trial = 1, 50
      xi = random_place(kind, 0.5_wp, random)
      call shape_values(kind, xi, n)
      call shape_slopes(kind, xi, dn)
      worst(2) = max(worst(2), abs(sum(n) - 1.0_wp))
      worst(3) = max(worst(3), maxval(abs(sum(dn, dim=2))))
      worst(4) = max(worst(4), maxval(abs(matmul(node, n) - xi)))
      do k = 1, kind_dim(kind)
        h_k = 0.0_wp
        h_k(k) = h
        call shape_values(kind, xi + h_k, above)
        call shape_values(kind, xi - h_k, below)
        worst(5) = max(worst(5), maxval(abs(dn(k, :) - (above - below)/(2*h))))
      end do
    end do
    call check(worst(1), 0.0_wp, 4*epsilon(1.0_wp), name_of(kind)//": 1 at one node and 0 at the others")
    call check(worst(2), 0.0_wp, 32*epsilon(1.0_wp), name_of(kind)//": partition of unity")
    call check(worst(3), 0.0_wp, 64*epsilon(1.0_wp), name_of(kind)//": sum of slopes")
    call check(worst(4), 0.0_wp, 32*epsilon(1.0_wp), name_of(kind)//": linear fields")
    call check(worst(5), 0.0_wp, 1.0e-9_wp, name_of(kind)//": slopes equal differences")
  end subroutine test_functions

  !> xi -> x -> xi inside; places on nodes and sides too. Up to a quarter outside the place must come back where it has natural coordinates.
  !> Errors of elements whose det J is 0.03 of the mean somewhere are about 1/0.03 times round-off times the distance from the node
  subroutine test_there_and_back(kind, distortion, least, stretch, atol, what)
    integer, intent(in) :: kind
    real(wp), intent(in) :: distortion, least, stretch, atol
    character(len=*), intent(in) :: what
    real(wp) :: xe(kind_dim(kind), kind_nodes(kind)), node(kind_dim(kind), kind_nodes(kind)), n(kind_nodes(kind))
    real(wp) :: xi(kind_dim(kind)), back(kind_dim(kind)), worst, farther
    integer :: trial, place, lost
    logical :: ok
    node = natural_nodes(kind)
    worst = 0.0_wp
    farther = 0.0_wp
    lost = 0
    do trial = 1, 200
      xe = made_element(kind, distortion, least, stretch, 0.0_wp, random)
      do place = 1, 20 + kind_nodes(kind)
        if (place <= 20) xi = random_place(kind, 0.0_wp, random)
        if (place > 20) xi = node(:, place - 20)
        call shape_values(kind, xi, n)
        call natural_coordinates(kind, xe, matmul(xe, n), back, ok)
        if (.not. ok) lost = lost + 1
        if (ok) worst = max(worst, maxval(abs(back - xi)))
      end do
      xi = random_place(kind, 0.25_wp, random)
      call shape_values(kind, xi, n)
      call natural_coordinates(kind, xe, matmul(xe, n), back, ok)
      if (.not. ok .or. distortion > 0.3_wp) cycle
      call shape_values(kind, back, n) ! another place that is mapped there is right as well
      call natural_coordinates(kind, xe, matmul(xe, n), xi, ok)
      farther = max(farther, maxval(abs(back - xi)))
    end do
    call check(lost, 0, name_of(kind)//", "//what//": places inside that were not found")
    call check(worst, 0.0_wp, atol, name_of(kind)//", "//what//": there and back")
    call check(farther, 0.0_wp, 10*atol, name_of(kind)//", "//what//": there and back somewhat outside")
  end subroutine test_there_and_back

  !> Places outside are told so, mapped up to half an element outside; no number and infinity are outside too
  subroutine test_outside(kind)
    integer, intent(in) :: kind
    real(wp) :: xe(kind_dim(kind), kind_nodes(kind)), n(kind_nodes(kind)), xi(kind_dim(kind)), back(kind_dim(kind)), x(kind_dim(kind))
    integer :: trial, wrong, unmapped, k
    logical :: ok
    wrong = 0
    unmapped = 0
    do trial = 1, 300
      xe = made_element(kind, 0.2_wp, 0.4_wp, 2.0_wp, 20.0_wp, random)
      xi = random_place(kind, 0.2_wp, random)
      if (beyond(kind, xi) <= 1.0e-12_wp) cycle
      call shape_values(kind, xi, n)
      call natural_coordinates(kind, xe, matmul(xe, n), back, ok)
      if (.not. ok) unmapped = unmapped + 1
      if (.not. beyond(kind, back) > 0.0_wp) wrong = wrong + 1
      x = xe(:, 1) + 30*(xe(:, 1) - sum(xe, dim=2)/kind_nodes(kind))
      call natural_coordinates(kind, xe, x, back, ok)
      if (.not. beyond(kind, back) > 0.0_wp) wrong = wrong + 1
    end do
    call check(wrong, 0, name_of(kind)//": places outside taken for inside")
    call check(unmapped, 0, name_of(kind)//": places just outside are mapped")
    xe = natural_nodes(kind)
    do trial = 1, 20
      xi = random_place(kind, 0.9_wp, random)
      call shape_values(kind, xi, n)
      call natural_coordinates(kind, xe, matmul(xe, n), back, ok)
      call check(back, xi, 1.0e-13_wp, name_of(kind)//": half an element outside")
    end do
    call ieee_set_halting_mode(ieee_invalid, .false.) ! debug builds stop for what is no number
    do k = 1, kind_dim(kind)
      x = 0.1_wp
      x(k) = ieee_value(1.0_wp, ieee_quiet_nan)
      call natural_coordinates(kind, xe, x, back, ok)
      call check_true(.not. ok .and. beyond(kind, back) > 1.0_wp, name_of(kind)//": no number is outside")
      call check_true(beyond(kind, x) > 1.0_wp, name_of(kind)//": natural coordinates that are no number are outside")
    end do
    call ieee_set_flag(ieee_invalid, .false.)
  end subroutine test_outside

  !> Volumes and heights of natural elements, scaled and turned ones, and additivity: the volume is that of the parts
  subroutine test_measures(kind)
    integer, intent(in) :: kind
    real(wp), parameter :: volume(n_kinds) = [2.0_wp, 0.5_wp, 0.5_wp, 4.0_wp, 4.0_wp, 4.0_wp, 1.0_wp/6, 8.0_wp]
    real(wp), parameter :: height(n_kinds) = [2.0_wp, sqrt(0.5_wp), 0.5_wp*sqrt(0.5_wp), 2.0_wp, 1.0_wp, 1.0_wp, 1.0_wp/sqrt(3.0_wp), &
      2.0_wp]
    real(wp) :: xe(kind_dim(kind), kind_nodes(kind)), x(kind_dim(kind)), back(kind_dim(kind))
    real(wp) :: low(kind_dim(kind)), high(kind_dim(kind)), share
    integer :: trial, k, inside
    logical :: ok
    xe = natural_nodes(kind)
    call check(element_volume(kind, xe), volume(kind), 1.0e-14_wp, name_of(kind)//": volume of the natural element")
    call check(element_height(kind, xe), height(kind), 1.0e-14_wp, name_of(kind)//": height of the natural element")
    call check(smallest_jacobian(kind, xe), 1.0_wp, 1.0e-14_wp, name_of(kind)//": det J of the natural element")
    call check(element_height(kind, 3*xe + 5), 3*height(kind), 1.0e-13_wp, name_of(kind)//": heights scale")
    xe = made_element(kind, 0.2_wp, 0.4_wp, 2.0_wp, 0.0_wp, random)
    call check(element_volume(kind, xe + 1000), element_volume(kind, xe), 1.0e-12_wp, name_of(kind)//": volume far from the origin")
    ! the share of places of its box that are inside: 10000 throws know it to 0.5/sqrt(10000), four deviations are 0.02
    inside = 0
    low = minval(xe, dim=2) - 0.1_wp
    high = maxval(xe, dim=2) + 0.1_wp
    do trial = 1, 10000
      do k = 1, kind_dim(kind)
        x(k) = low(k) + (high(k) - low(k))*random_number_of(random)
      end do
      call natural_coordinates(kind, xe, x, back, ok)
      if (beyond(kind, back) <= 0.0_wp) inside = inside + 1
    end do
    share = inside/10000.0_wp
    call check(share, element_volume(kind, xe)/product(high - low), 0.02_wp, &
      name_of(kind)//": volume against the share of places inside")
  end subroutine test_measures

  !> Elements without volume, flipped or folded ones are told by their shape; a place in one without volume has no natural coordinates
  subroutine test_bad(kind)
    integer, intent(in) :: kind
    real(wp) :: xe(kind_dim(kind), kind_nodes(kind)), xi(kind_dim(kind)), flat(kind_dim(kind), kind_nodes(kind))
    integer :: d
    logical :: ok
    d = kind_dim(kind)
    xe = natural_nodes(kind)
    flat = xe
    flat(d, :) = 0.5_wp
    if (d > 1) flat(d, :) = flat(1, :)
    call check(smallest_jacobian(kind, flat), -1.0_wp, 0.0_wp, name_of(kind)//": without volume")
    call check(element_height(kind, flat), 0.0_wp, 0.0_wp, name_of(kind)//": height without volume")
    call natural_coordinates(kind, flat, 0.3_wp*flat(:, 2) + 0.7_wp*flat(:, 1), xi, ok)
    call check_true(.not. ok .and. beyond(kind, xi) > 1.0_wp, name_of(kind)//": nothing is inside of an element without volume")
    flat = 0.25_wp
    call natural_coordinates(kind, flat, flat(:, 1), xi, ok)
    call check_true(.not. ok, name_of(kind)//": nor of one that is a point")
    call check(smallest_jacobian(kind, flat), -1.0_wp, 0.0_wp, name_of(kind)//": a point")
    call check(element_height(kind, flat), 0.0_wp, 0.0_wp, name_of(kind)//": height of a point")
    flat = xe
    flat(d, :) = -xe(d, :)
    call check_true(element_volume(kind, flat) < 0.0_wp, name_of(kind)//": a flipped element has a negative volume")
    call check_true(smallest_jacobian(kind, flat) < 0.0_wp, name_of(kind)//": and is told by its shape")
    call check(element_height(kind, flat), 0.0_wp, 0.0_wp, name_of(kind)//": height of a flipped element")
    if (any(kind == [line2, triangle3, tetrahedron4])) return
    flat = xe
    if (kind == triangle6) flat(:, 4) = [0.2_wp, 0.0_wp] ! closer to a corner than a quarter of the side
    if (kind == hexahedron8) flat(:, 1) = [0.5_wp, 0.5_wp, 0.5_wp]
    if (d == 2 .and. kind /= triangle6) flat(:, 1) = [0.5_wp, 0.5_wp]
    call check_true(element_volume(kind, flat) > 0.0_wp .and. smallest_jacobian(kind, flat) < 0.0_wp, name_of(kind)//": folded")
  end subroutine test_bad

  !> Quads with natural coordinates known exactly (rational arithmetic)
  subroutine test_known_pairs()
    real(wp), parameter :: wide = 2.0_wp**20
    call pair("parallelogram", [0.0_wp, 0.0_wp, 4.0_wp, 1.0_wp, 5.0_wp, 4.0_wp, 1.0_wp, 3.0_wp], [3.125_wp, 1.125_wp])
    call pair("kite", [0.0_wp, -1.0_wp, 3.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, -1.0_wp, 0.0_wp], [1.9375_wp, -0.125_wp])
    call pair("aspect 2^20", [0.0_wp, 0.0_wp, wide, 0.0_wp, wide, 1.0_wp, 0.0_wp, 2.0_wp], [786432.0_wp, 0.15625_wp])
  end subroutine test_known_pairs

  subroutine pair(what, corners, x)
    character(len=*), intent(in) :: what
    real(wp), intent(in) :: corners(8), x(2)
    real(wp) :: xi(2), xe(2, 9)
    logical :: ok
    xe(:, 1:4) = reshape(corners, [2, 4])
    call natural_coordinates(quad4, xe(:, 1:4), x, xi, ok)
    call check(xi, [0.5_wp, -0.75_wp], 1.0e-12_wp, what)
    xe(:, 5:8) = 0.5_wp*(xe(:, 1:4) + xe(:, [2, 3, 4, 1]))
    xe(:, 9) = 0.25_wp*sum(xe(:, 1:4), dim=2)
    call natural_coordinates(quad8, xe(:, 1:8), x, xi, ok) ! by Newton's method
    call check(xi, [0.5_wp, -0.75_wp], 1.0e-12_wp, what//" of eight nodes")
    call natural_coordinates(quad9, xe, x, xi, ok)
    call check(xi, [0.5_wp, -0.75_wp], 1.0e-12_wp, what//" of nine nodes")
  end subroutine pair

  !> Quads on which closed forms fail: parallelograms and trapezoids (all but), and those with an edge of no length
  subroutine test_special_quads()
    real(wp), parameter :: shears(5) = [0.0_wp, 1.0e-15_wp, 1.0e-13_wp, 1.0e-8_wp, 0.3_wp]
    real(wp) :: xe(2, 4), xi(2), back(2), n(4), worst, places, within
    integer :: i, k, trial
    logical :: ok
    worst = 0.0_wp
    do i = 1, size(shears)
      do k = 1, 4 ! trapezoids with the short side anywhere
        xe = 0.5_wp*natural_nodes(quad4)
        xe(modulo(k, 2) + 1, k) = (1.0_wp - shears(i))*xe(modulo(k, 2) + 1, k)
        if (i == 2) xe = matmul(reshape([1.0_wp, 0.4_wp, 0.3_wp, 1.1_wp], [2, 2]), xe)
        do trial = 1, 50
          xi = random_place(quad4, 0.0_wp, random)
          call shape_values(quad4, xi, n)
          call natural_coordinates(quad4, xe, matmul(xe, n), back, ok)
          call check_true(ok, "parallelograms and trapezoids, all but")
          worst = max(worst, maxval(abs(back - xi)))
        end do
      end do
    end do
    call check(worst, 0.0_wp, 1.0e-14_wp, "parallelograms and trapezoids, all but")
    ! an edge without length: where it is, one natural coordinate means nothing, so places are compared; det J is known to the root of
    ! round-off there
    worst = 0.0_wp
    places = 0.0_wp
    within = 0.0_wp
    do k = 1, 4
      xe = natural_nodes(quad4)
      xe(:, k) = xe(:, 1 + modulo(k, 4))
      do trial = 1, 400
        xi = random_place(quad4, 0.0_wp, random)
        if (trial <= 50) xi(1) = sign(1.0_wp - 1.0e-9_wp, xi(1))
        if (trial <= 100) xi(2) = sign(1.0_wp - 1.0e-9_wp, xi(2))
        call shape_values(quad4, xi, n)
        call natural_coordinates(quad4, xe, matmul(xe, n), back, ok)
        call check_true(ok, "a collapsed edge: found")
        if (determinant_at(xe, xi) > 0.1_wp) worst = max(worst, maxval(abs(back - xi)))
        call shape_values(quad4, xi, n)
        xi = matmul(xe, n)
        call shape_values(quad4, back, n)
        places = max(places, maxval(abs(matmul(xe, n) - xi)))
        if (trial > 100) within = max(within, maxval(abs(matmul(xe, n) - xi)))
      end do
      call natural_coordinates(quad4, xe, 1.1_wp*xe(:, k), back, ok)
      call check_true(beyond(quad4, back) > 0.0_wp, "a collapsed edge: beyond its vertex is outside")
      call check(smallest_jacobian(quad4, xe), 0.0_wp, 1.0e-15_wp, "a collapsed edge: told by the shape")
      call check(element_height(quad4, xe), 0.0_wp, 1.0e-15_wp, "a collapsed edge: no height")
    end do
    call check(worst, 0.0_wp, 1.0e-13_wp, "a collapsed edge: there and back")
    call check(within, 0.0_wp, 1.0e-12_wp, "a collapsed edge: places")
    call check(places, 0.0_wp, 1.0e-8_wp, "a collapsed edge: places next to it")
  end subroutine test_special_quads

  real(wp) function determinant_at(xe, xi)
    real(wp), intent(in) :: xe(2, 4), xi(2)
    real(wp) :: j(2, 2)
    j = jacobian(quad4, xe, xi)
    determinant_at = j(1, 1)*j(2, 2) - j(1, 2)*j(2, 1)
  end function determinant_at

  !> A quad with one side bulging by b has b*2/3 more area (Simpson's rule is exact for parabolas)
  subroutine test_curved_volume()
    real(wp) :: xe(2, 9)
    xe = 0.5_wp*natural_nodes(quad9)
    xe(1, 6) = xe(1, 6) + 0.15_wp
    call check(element_volume(quad9, xe), 1.1_wp, 1.0e-14_wp, "area of a quad of nine nodes with a parabola for a side")
    call check(element_volume(quad8, xe(:, 1:8)), 1.1_wp, 1.0e-14_wp, "area of a quad of eight nodes with a parabola for a side")
    xe(:, 1:6) = natural_nodes(triangle6)
    xe(2, 4) = xe(2, 4) - 0.15_wp
    call check(element_volume(triangle6, xe(:, 1:6)), 0.6_wp, 1.0e-14_wp, "area of a triangle with a parabola for a side")
  end subroutine test_curved_volume

  !> Volume and smallest det J of distorted hexahedra from J itself, at Gauss points and at lattices. Nine places an axis find at most a little
  !> less than the three that are looked at
  subroutine test_hexahedra()
    real(wp), parameter :: gauss = 1.0_wp/sqrt(3.0_wp)
    real(wp) :: xe(3, 8), volume, least(2), det
    integer :: n, i, j, k
    do n = 1, 100
      xe = made_element(hexahedron8, 0.4_wp, 0.05_wp, 3.0_wp, 1.0_wp, random)
      volume = 0.0_wp
      least = huge(1.0_wp)
      do k = -4, 4
        do j = -4, 4
          do i = -4, 4
            det = determinant_of(jacobian(hexahedron8, xe, 0.25_wp*[i, j, k]))
            least(1) = min(least(1), det)
            if (all(modulo([i, j, k], 4) == 0)) least(2) = min(least(2), det)
            if (all(abs([i, j, k]) == 1)) volume = volume + determinant_of(jacobian(hexahedron8, xe, gauss*[i, j, k]))
          end do
        end do
      end do
      call check(element_volume(hexahedron8, xe), volume, 1.0e-13_wp*volume, "volume of a hexahedron") ! sums of 27 and 8 values, rounded
      call check(smallest_jacobian(hexahedron8, xe), 8*least(2)/volume, 1.0e-13_wp, "smallest det J of a hexahedron")
      call check_true(smallest_jacobian(hexahedron8, xe) < 8*least(1)/volume + 0.05_wp, "smallest det J of a hexahedron: places between")
    end do
  end subroutine test_hexahedra

  pure real(wp) function determinant_of(j)
    real(wp), intent(in) :: j(3, 3)
    determinant_of = j(1, 1)*(j(2, 2)*j(3, 3) - j(2, 3)*j(3, 2)) - j(1, 2)*(j(2, 1)*j(3, 3) - j(2, 3)*j(3, 1)) &
      + j(1, 3)*(j(2, 1)*j(3, 2) - j(2, 2)*j(3, 1))
  end function determinant_of

  function name_of(kind)
    integer, intent(in) :: kind
    character(len=:), allocatable :: name_of
    name_of = trim(kind_name(kind))
  end function name_of

end program test_elements
