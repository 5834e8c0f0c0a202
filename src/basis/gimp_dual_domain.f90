!> Weights of the dual domain method (Zhang, Ma & Giguere 2011): S is the tent N, and its gradient is smeared over the nodes,
!>   G_i = alpha grad N_i + (1 - alpha) sum_j N_j Gbar_ji,  Gbar_ji = (1/V_j) int N_j grad N_i,  V_j = int N_j,
!> with alpha = alpha_max prod_k 4 xi_k (1 - xi_k), xi the place in the cell: 0 on all faces, so that G is continuous there.
!>
!> The method is written as two stages on nodes (nodal stresses Sigma_j = (1/V_j) sum_p V_p (1 - alpha_p) N_j sigma_p, then forces
!> from V_j Gbar_ji; nodal velocity gradients H_j, then their interpolation). On equal cells N_j and Gbar_ji are products over the
!> axes, and so is sum_j N_j Gbar_ji: rows of 4 nodes, along k the slope sum_j N_j d_ji, across it the mean sum_j N_j m_ji with
!>   d_j = (-1/2, 0, 1/2), m_j = (1, 4, 1)/6;  at a side of the box, whose node has half a volume, (-1, 1) and (2, 1)/3.
!> Summed at the particle, the two stages are one pass with these weights. Force and velocity gradient take the same G, so they stay
!> adjoint, sum G = 0 and sum x_i (x) G = I. Lengths in cells, G per cell.
module gimp_dual_domain
  use gimp_kinds, only: wp, lanes
  use gimp_grid, only: grid_t
  use gimp_basis, only: weight_list_t
  implicit none(type, external)
  private
  public :: dual_ends, smear_tents, make_dual_list, dual_reach

  real(wp), parameter :: dual_reach = 1.0_wp !! supports begin at node floor(x - dual_reach)
  real(wp), parameter :: nowhere = 1.0e6_wp !! beyond any node of a block

contains

  !> Where rows become one-sided: the sides of the box as the block at `at` sees them [cells]. Periodic and symmetric sides are none.
  pure subroutine dual_ends(grid, at, low, high)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: at(3) !! coordinates of the block that positions refer to
    real(wp), intent(out) :: low(3), high(3)
    low = merge(-nowhere, -real(at*grid%edge, wp), grid%periodic .or. grid%mirror_low)
    high = merge(nowhere, real(grid%cells - at*grid%edge, wp), grid%periodic .or. grid%mirror_high)
  end subroutine dual_ends

  !> Rows of smeared means and slopes of the lanes of a chunk, from their tents
  pure subroutine smear_tents(axes, inner, tent, low, high, strongest, mean, slope, alpha)
    integer, intent(in) :: axes
    integer, intent(in) :: inner(lanes, axes) !! lower node of the cell; rows begin one node below
    real(wp), intent(in) :: tent(lanes, 2, axes)
    real(wp), intent(in) :: low(3), high(3) !! where rows become one-sided [cells]
    real(wp), intent(in) :: strongest !! alpha_max
    real(wp), intent(out) :: mean(lanes, 4, axes), slope(lanes, 4, axes)
    real(wp), intent(out) :: alpha(lanes)
    real(wp) :: node, a, b, below, above, part
    integer :: k, l
    alpha = strongest
    do k = 1, axes
      !$omp simd simdlen(lanes) private(node, a, b, below, above, part)
      do l = 1, lanes
        a = tent(l, 1, k)
        b = tent(l, 2, k)
        alpha(l) = alpha(l)*4.0_wp*a*b
        node = inner(l, k)
        below = merge(1.0_wp, 0.0_wp, node > low(k)) ! is there a cell on that side of the lower node
        above = merge(1.0_wp, 0.0_wp, node < high(k))
        part = a/(below + above)
        mean(l, 1, k) = (1.0_wp/3.0_wp)*below*part
        mean(l, 3, k) = (1.0_wp/3.0_wp)*above*part
        slope(l, 1, k) = -below*part
        slope(l, 3, k) = above*part
        below = merge(1.0_wp, 0.0_wp, node + 1.0_wp > low(k)) ! and of the upper one
        above = merge(1.0_wp, 0.0_wp, node + 1.0_wp < high(k))
        part = b/(below + above)
        mean(l, 2, k) = (2.0_wp/3.0_wp)*a + (1.0_wp/3.0_wp)*below*part
        mean(l, 3, k) = mean(l, 3, k) + (2.0_wp/3.0_wp)*b
        mean(l, 4, k) = (1.0_wp/3.0_wp)*above*part
        slope(l, 4, k) = above*part
        slope(l, 3, k) = slope(l, 3, k) + (below - above)*part
        slope(l, 2, k) = -(slope(l, 1, k) + slope(l, 3, k) + slope(l, 4, k))
      end do
    end do
  end subroutine smear_tents

  !> The weight list of one particle
  pure subroutine make_dual_list(dim, x, low, high, strongest, list)
    integer, intent(in) :: dim
    real(wp), intent(in) :: x(:) !! (dim) [cells]
    real(wp), intent(in) :: low(3), high(3) !! where rows become one-sided [cells]
    real(wp), intent(in) :: strongest !! alpha_max
    type(weight_list_t), intent(inout) :: list
    real(wp), dimension(4, 3) :: tent, own, mean, slope
    real(wp) :: m(-1:1), d(-1:1), alpha, b
    integer :: first(3), n(3), i, j, k, at(3)
    first = 0
    n = 1
    tent = 1.0_wp
    mean = 1.0_wp
    own = 0.0_wp
    slope = 0.0_wp
    alpha = strongest
    do k = 1, dim
      first(k) = floor(x(k)) - 1
      n(k) = 4
      b = x(k) - floor(x(k))
      alpha = alpha*4.0_wp*b*(1.0_wp - b)
      tent(:, k) = [0.0_wp, 1.0_wp - b, b, 0.0_wp]
      own(:, k) = [0.0_wp, -1.0_wp, 1.0_wp, 0.0_wp]
      mean(:, k) = 0.0_wp
      do j = 2, 3
        call node_row(real(first(k) + j - 1, wp), low(k), high(k), m, d)
        mean(j - 1:j + 1, k) = mean(j - 1:j + 1, k) + tent(j, k)*m
        slope(j - 1:j + 1, k) = slope(j - 1:j + 1, k) + tent(j, k)*d
      end do
    end do
    list%n = 0
    do k = 1, n(3)
      do j = 1, n(2)
        do i = 1, n(1)
          at = [i, j, k]
          list%n = list%n + 1
          list%node(:, list%n) = first + at - 1
          list%s(list%n) = tent(i, 1)*tent(j, 2)*tent(k, 3)
          list%g(:, list%n) = alpha*gradient(tent, own) + (1.0_wp - alpha)*gradient(mean, slope)
        end do
      end do
    end do

  contains

    !> Slopes along each axis times values along the others
    pure function gradient(value, along) result(g)
      real(wp), intent(in) :: value(4, 3), along(4, 3)
      real(wp) :: g(3)
      g = [along(at(1), 1)*value(at(2), 2)*value(at(3), 3), value(at(1), 1)*along(at(2), 2)*value(at(3), 3), &
           value(at(1), 1)*value(at(2), 2)*along(at(3), 3)]
    end function gradient

  end subroutine make_dual_list

  !> Means (1/V_j) int N_j N_i and slopes (1/V_j) int N_j N_i' over the nodes i = j - 1, j, j + 1 of one axis
  pure subroutine node_row(j, low, high, m, d)
    real(wp), intent(in) :: j, low, high
    real(wp), intent(out) :: m(-1:1), d(-1:1)
    real(wp) :: volume
    m = 0.0_wp
    d = 0.0_wp
    volume = 0.0_wp
    if (j > low) then
      m(-1:0) = [1.0_wp, 2.0_wp]/6.0_wp
      d(-1:0) = [-0.5_wp, 0.5_wp]
      volume = 0.5_wp
    end if
    if (j < high) then
      m(0:1) = m(0:1) + [2.0_wp, 1.0_wp]/6.0_wp
      d(0:1) = d(0:1) + [-0.5_wp, 0.5_wp]
      volume = volume + 0.5_wp
    end if
    m = m/volume
    d = d/volume
  end subroutine node_row

end module gimp_dual_domain
