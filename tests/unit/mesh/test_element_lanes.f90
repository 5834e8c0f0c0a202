!> Weights of elements for the lanes of a chunk: equal to those of single elements, tents in squares and cubes, each lane by itself
program test_element_lanes
  use gimp_kinds, only: wp, lanes
  use gimp_mesh, only: quad4, hexahedron8, n_kinds, kind_name, kind_dim, kind_nodes
  use gimp_elements, only: shape_values, shape_gradients, natural_coordinates, beyond
  use gimp_element_lanes, only: lane_weights, lane_weights_slopes
  use gimp_made_meshes, only: random_t, random_number_of
  use gimp_made_elements, only: natural_nodes, made_element, random_place
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  use, intrinsic :: ieee_exceptions, only: ieee_invalid, ieee_set_flag, ieee_set_halting_mode
  implicit none(type, external)

  type(random_t) :: random
  integer :: kind

  call begin_suite("element lanes")
  do kind = 1, n_kinds
    call test_equal(kind, 0.0_wp, 0.9_wp, "parallelograms")
    call test_equal(kind, 0.3_wp, 0.3_wp, "30 % distorted")
    call test_equal(kind, 0.45_wp, 0.1_wp, "strongly distorted")
    call test_by_itself(kind)
  end do
  call test_tents(2, quad4)
  call test_tents(3, hexahedron8)
  call end_suite()

contains

  !> Another element and another place in every lane, some somewhat outside
  subroutine fill(kind, distortion, least, reach, xe, x)
    integer, intent(in) :: kind
    real(wp), intent(in) :: distortion, least, reach
    real(wp), intent(out) :: xe(:, :, :), x(:, :)
    real(wp) :: one(kind_dim(kind), kind_nodes(kind)), n(kind_nodes(kind))
    integer :: l
    do l = 1, lanes
      one = made_element(kind, distortion, least, 2.0_wp, reach, random)
      call shape_values(kind, random_place(kind, merge(0.3_wp, 0.0_wp, modulo(l, 3) == 0), random), n)
      xe(l, :, :) = one
      x(l, :) = matmul(one, n)
    end do
  end subroutine fill

  !> Lanes against single elements. Where det J is a tenth of its mean gradients are ten times larger, and round-off of 20 cells, the
  !> distance from the origin, is amplified as much: 20*10*epsilon is 4e-14. Gradients change with places by about their square.
  subroutine test_equal(kind, distortion, least, what)
    integer, intent(in) :: kind
    real(wp), intent(in) :: distortion, least
    character(len=*), intent(in) :: what
    real(wp) :: xe(lanes, kind_dim(kind), kind_nodes(kind)), x(lanes, kind_dim(kind)), w(lanes, kind_nodes(kind)), over(lanes)
    real(wp) :: w2(lanes, kind_nodes(kind)), g(lanes, kind_dim(kind), kind_nodes(kind)), over2(lanes)
    real(wp) :: one(kind_dim(kind), kind_nodes(kind)), n(kind_nodes(kind)), slope(kind_dim(kind), kind_nodes(kind)), xi(kind_dim(kind))
    real(wp) :: unit(kind_dim(kind), kind_dim(kind)), worst(8)
    integer :: trial, l, k, outside
    logical :: ok
    worst = 0.0_wp
    outside = 0
    do trial = 1, 40
      call fill(kind, distortion, least, 20.0_wp, xe, x)
      call lane_weights(kind, kind_dim(kind), kind_nodes(kind), xe, x, w, over)
      call lane_weights_slopes(kind, kind_dim(kind), kind_nodes(kind), xe, x, w2, g, over2)
      worst(1) = max(worst(1), maxval(abs(w - w2)), maxval(abs(over - over2)))
      do l = 1, lanes
        one = xe(l, :, :)
        call natural_coordinates(kind, one, x(l, :), xi, ok)
        if (over(l) > 1.0e-12_wp) outside = outside + 1
        if (.not. ok) then
          worst(2) = max(worst(2), merge(0.0_wp, 1.0_wp, over(l) > 0.0_wp))
          cycle
        end if
        call shape_values(kind, xi, n)
        call shape_gradients(kind, one, xi, slope)
        worst(2) = max(worst(2), abs(over(l) - beyond(kind, xi)))
        worst(3) = max(worst(3), maxval(abs(w(l, :) - n)))
        worst(4) = max(worst(4), maxval(abs(g(l, :, :) - slope))/maxval(abs(slope))**2)
        worst(5) = max(worst(5), abs(sum(w(l, :)) - 1.0_wp))
        worst(6) = max(worst(6), maxval(abs(matmul(one, w(l, :)) - x(l, :))))
        worst(7) = max(worst(7), maxval(abs(sum(g(l, :, :), dim=2))))
        unit = matmul(one, transpose(g(l, :, :)))
        do k = 1, kind_dim(kind)
          unit(k, k) = unit(k, k) - 1.0_wp
        end do
        worst(8) = max(worst(8), maxval(abs(unit)))
      end do
    end do
    call check_true(outside > 10, name_of(kind)//", "//what//": places outside among them")
    call check(worst(1), 0.0_wp, 1.0e-13_wp, name_of(kind)//", "//what//": with and without gradients")
    call check(worst(2), 0.0_wp, 1.0e-12_wp, name_of(kind)//", "//what//": how far outside")
    call check(worst(3), 0.0_wp, 1.0e-12_wp, name_of(kind)//", "//what//": weights")
    call check(worst(4), 0.0_wp, 1.0e-12_wp, name_of(kind)//", "//what//": gradients")
    call check(worst(5), 0.0_wp, 1.0e-14_wp, name_of(kind)//", "//what//": partition of unity")
    call check(worst(6), 0.0_wp, 1.0e-13_wp, name_of(kind)//", "//what//": places")
    call check(worst(7), 0.0_wp, 1.0e-12_wp, name_of(kind)//", "//what//": sum of gradients")
    call check(worst(8), 0.0_wp, 1.0e-10_wp, name_of(kind)//", "//what//": gradient of places") ! 20 cells times gradients near folds
  end subroutine test_equal

  !> What a lane gets does not depend on the others, be they far outside or no numbers; those are outside
  subroutine test_by_itself(kind)
    integer, intent(in) :: kind
    real(wp) :: xe(lanes, kind_dim(kind), kind_nodes(kind)), x(lanes, kind_dim(kind)), w(lanes, kind_nodes(kind)), over(lanes)
    real(wp) :: g(lanes, kind_dim(kind), kind_nodes(kind)), w1(kind_nodes(kind)), g1(kind_dim(kind), kind_nodes(kind)), over1
    integer :: trial, dim, nodes
    dim = kind_dim(kind)
    nodes = kind_nodes(kind)
    call ieee_set_halting_mode(ieee_invalid, .false.) ! debug builds stop for what is no number
    do trial = 1, 20
      call fill(kind, 0.3_wp, 0.2_wp, 20.0_wp, xe, x)
      call lane_weights_slopes(kind, dim, nodes, xe, x, w, g, over)
      w1 = w(1, :)
      g1 = g(1, :, :)
      over1 = over(1)
      xe(2, :, :) = xe(1, :, :) ! as spare lanes are
      x(2, :) = x(1, :)
      x(3, :) = x(3, :) + 7.5_wp
      x(4, 1) = ieee_value(1.0_wp, ieee_quiet_nan)
      x(5, dim) = 1.0e6_wp
      call lane_weights_slopes(kind, dim, nodes, xe, x, w, g, over)
      call check_true(all(w(1, :) == w1) .and. all(g(1, :, :) == g1) .and. over(1) == over1, name_of(kind)//": lanes by themselves")
      call check_true(all(w(2, :) == w1) .and. all(g(2, :, :) == g1), name_of(kind)//": spare lanes")
      call check_true(over(3) > 0.5_wp .and. over(5) > 0.5_wp .and. .not. over(4) <= 1.0_wp, name_of(kind)//": far outside and no number")
      call lane_weights(kind, dim, nodes, xe, x, w, over)
      call check(w(1, :), w1, 1.0e-13_wp, name_of(kind)//": weights beside no numbers")
      call check_true(over(3) > 0.5_wp .and. over(5) > 0.5_wp .and. .not. over(4) <= 1.0_wp, name_of(kind)//": no number without gradients")
    end do
    call ieee_set_flag(ieee_invalid, .false.)
  end subroutine test_by_itself

  !> Squares and cubes of edge 1 up to 1000 cells from the origin: tents to the last bits
  subroutine test_tents(dim, kind)
    integer, intent(in) :: dim, kind
    real(wp) :: xe(lanes, dim, 2**dim), x(lanes, dim), w(lanes, 2**dim), g(lanes, dim, 2**dim), over(lanes), node(dim, 2**dim)
    real(wp) :: tent(dim, 2**dim), slope(dim), worst(2)
    integer :: trial, l, k, n
    node = 0.5_wp*(natural_nodes(kind) + 1.0_wp)
    worst = 0.0_wp
    do trial = 1, 50
      do l = 1, lanes
        do k = 1, dim
          x(l, k) = 1000*random_number_of(random)
          xe(l, k, :) = aint(x(l, k)) + node(k, :)
        end do
      end do
      call lane_weights_slopes(kind, dim, 2**dim, xe, x, w, g, over)
      do l = 1, lanes
        do n = 1, 2**dim
          tent(:, n) = 1.0_wp - abs(x(l, :) - xe(l, :, n))
          worst(1) = max(worst(1), abs(w(l, n) - product(tent(:, n))))
          do k = 1, dim
            slope = tent(:, n)
            slope(k) = 2*node(k, n) - 1.0_wp
            worst(2) = max(worst(2), abs(g(l, k, n) - product(slope)))
          end do
        end do
      end do
    end do
    call check(worst(1), 0.0_wp, 4*epsilon(1.0_wp), name_of(kind)//": tents")
    call check(worst(2), 0.0_wp, 4*epsilon(1.0_wp), name_of(kind)//": slopes of tents")
  end subroutine test_tents

  function name_of(kind)
    integer, intent(in) :: kind
    character(len=:), allocatable :: name_of
    name_of = trim(kind_name(kind))
  end function name_of

end program test_element_lanes
