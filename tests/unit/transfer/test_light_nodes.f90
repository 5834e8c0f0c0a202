!> Light nodes hand on force: nothing is lost, nothing happens where nodes are full, and the critical step no longer depends on how far
!> the last particle reaches beyond a node
program test_light_nodes
  use gimp_kinds, only: wp, lanes
  use gimp_basis, only: weight_list_t, make_weight_list
  use gimp_dual_domain, only: make_dual_list
  use gimp_splines, only: spline_t
  use gimp_light_nodes, only: hand_on
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: far(3) = 1.0e6_wp
  type(spline_t) :: none

  call begin_suite("light nodes")
  call test_sums()
  call test_formula()
  call test_kept()
  call test_critical_step()
  call end_suite()

contains

  !> The sum of forces stays, whatever nodes are light; full nodes change nothing, bit for bit
  subroutine test_sums()
    type(weight_list_t) :: list
    real(wp) :: light(64), f(3, 64), before(3, 64), moved, slope(3, 3), x(3)
    integer :: i, k
    call random_seed_of(3)
    do k = 1, 20
      call random_number(x)
      call random_number(slope)
      call random_number(light)
      if (modulo(k, 3) == 0) light = anint(light) ! nodes without any mass
      call make_dual_list(3, x + 2.0_wp, -far, far, 0.5_wp, list) ! forces where there is no weight, too
      call hand_on(3, list, 0.0_wp*light, slope, before, moved)
      call check(moved, 0.0_wp, 0.0_wp, "full nodes hand on nothing")
      do i = 1, list%n
        call check(maxval(abs(before(:, i) - matmul(slope, list%g(:, i)))), 0.0_wp, 1.0e-15_wp, "and keep their force")
      end do
      call hand_on(3, list, light, slope, f, moved)
      call check(maxval(abs(sum(f(:, :list%n) - before(:, :list%n), dim=2))), 0.0_wp, 1.0e-14_wp, "the sum of forces stays")
      call check_true(moved > 0.0_wp, "though some was handed on")
      if (modulo(k, 3) /= 0) cycle
      do i = 1, list%n ! something is left that can carry, or the force would stay
        if (light(i) > 0.5_wp) call check(maxval(abs(f(:, i))), 0.0_wp, 1.0e-14_wp, "nodes without mass get no force")
      end do
    end do
  end subroutine test_sums

  !> Against the sentence it comes from, node by node: (1 - c_i) f_i goes to j /= i in proportion S_j c_j
  subroutine test_formula()
    type(weight_list_t) :: list
    real(wp) :: light(9), f(3, 9), wanted(3, 9), own(3), moved, slope(3, 2), rest
    integer :: i, j
    call random_seed_of(5)
    call random_number(slope)
    call random_number(light)
    call make_weight_list(2, [0.3_wp, 0.8_wp], [0.4_wp, 0.3_wp], none, list)
    call check(real(list%n, wp), 9.0_wp, 0.0_wp, "nine nodes")
    wanted = 0.0_wp
    do i = 1, 9
      own = matmul(slope, list%g(:2, i))
      wanted(:, i) = wanted(:, i) + (1.0_wp - light(i))*own
      rest = 0.0_wp
      do j = 1, 9
        if (j /= i) rest = rest + list%s(j)*(1.0_wp - light(j))
      end do
      do j = 1, 9
        if (j /= i) wanted(:, j) = wanted(:, j) + light(i)*own*list%s(j)*(1.0_wp - light(j))/rest
      end do
    end do
    call hand_on(2, list, light, slope, f, moved)
    call check(maxval(abs(f - wanted)), 0.0_wp, 1.0e-14_wp, "shares")
  end subroutine test_formula

  !> Where no other node can carry, the force stays
  subroutine test_kept()
    type(weight_list_t) :: list
    real(wp) :: f(3, 2), moved
    call make_weight_list(1, [0.25_wp], [0.0_wp], none, list)
    call hand_on(1, list, [1.0_wp, 1.0_wp], reshape([1.0_wp, 0.0_wp, 0.0_wp], [3, 1]), f, moved)
    call check(f(1, 1), -1.0_wp, 0.0_wp, "both nodes light: force stays")
    call check(moved, 0.0_wp, 0.0_wp, "and nothing is counted")
    call hand_on(1, list, [0.0_wp, 1.0_wp], reshape([1.0_wp, 0.0_wp, 0.0_wp], [3, 1]), f, moved)
    call check(maxval(abs(f)), 0.0_wp, 1.0e-15_wp, "one light: the particle pulls at the other alone, which is nothing")
    call check(moved, 1.0_wp, 0.0_wp, "and that is counted")
  end subroutine test_kept

  !> A bar of two particles a cell and tents, the last one a distance eps beyond a node: critical step 2/sqrt(lambda) of M^-1 K in h/c,
  !> untreated and with m_c = 0.05 and 0.2 of a full node; the figures are those of the eigenvalues of the same matrices in numpy
  subroutine test_critical_step()
    real(wp), parameter :: eps(4) = [0.1_wp, 1.0e-2_wp, 1.0e-3_wp, 1.0e-6_wp]
    real(wp), parameter :: bare(4) = [0.61_wp, 0.20_wp, 0.063_wp, 0.0020_wp], small(4) = [0.61_wp, 0.63_wp, 0.63_wp, 0.63_wp]
    integer :: k
    do k = 1, 4
      call check(critical(eps(k), 0.0_wp), bare(k), 0.02_wp*bare(k), "untreated, eps = "//text_of(eps(k)))
      call check(critical(eps(k), 0.05_wp), small(k), 0.02_wp*small(k), "with m_c = 0.05, eps = "//text_of(eps(k)))
      call check(critical(eps(k), 0.2_wp), 1.006_wp, 0.003_wp, "with m_c = 0.2, eps = "//text_of(eps(k)))
    end do
  end subroutine test_critical_step

  !> The critical step by power iteration: the spectrum is real, and the operator is applied as a step does
  real(wp) function critical(eps, share)
    real(wp), intent(in) :: eps, share !! share: m_c of a full node, 0 for none
    integer, parameter :: cells = 12
    real(wp) :: m(0:cells + 1), light(0:cells + 1), v(0:cells + 1), a(0:cells + 1), f(3, 8), moved, strain, lambda, before
    type(weight_list_t) :: list
    integer :: p, step
    m = 0.0_wp
    do p = 0, 2*cells
      call make_weight_list(1, [eps + 0.5_wp*p], [0.0_wp], none, list)
      m(list%node(1, :2)) = m(list%node(1, :2)) + 0.5_wp*list%s(:2)
    end do
    light = 0.0_wp
    if (share > 0.0_wp) light = max(0.0_wp, 1.0_wp - m/share)
    v = [((-1.0_wp)**p*(1.0_wp + 0.1_wp*p), p=0, cells + 1)]
    lambda = 0.0_wp
    do step = 1, 4000
      v = v/norm2(v)
      a = 0.0_wp
      do p = 0, 2*cells
        call make_weight_list(1, [eps + 0.5_wp*p], [0.0_wp], none, list)
        strain = sum(list%g(1, :2)*v(list%node(1, :2)))
        call hand_on(1, list, light(list%node(1, :2)), reshape([-0.5_wp*strain, 0.0_wp, 0.0_wp], [3, 1]), f, moved)
        a(list%node(1, :2)) = a(list%node(1, :2)) + f(1, :2)
      end do
      a = -a/m
      before = lambda
      lambda = dot_product(a, v)
      if (abs(lambda - before) < 1.0e-7_wp*lambda) exit
      v = a
    end do
    critical = 2.0_wp/sqrt(lambda)
  end function critical

  subroutine random_seed_of(number)
    integer, intent(in) :: number
    integer :: length
    call random_seed(size=length)
    call random_seed(put=spread(number, 1, length))
  end subroutine random_seed_of

end program test_light_nodes
