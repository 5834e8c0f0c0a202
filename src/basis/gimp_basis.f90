!> Weights of each family as a list: which nodes, with which weight S and gradient G, for one particle.
!>
!> These are the readable forms; the fast kernels of `transfer` are specialisations of them and are tested equal.
!> With open-knot splines a node's position is its Greville abscissa. Every list satisfies sum S = 1, sum G = 0, sum x_i S = x_p, sum x_i (x) G = I to round-off. Lengths in units of the
!> spacing, so G is per spacing.
module gimp_basis
  use gimp_kinds, only: wp
  use gimp_splines, only: spline_t, spline_weights, node_place
  implicit none(type, external)
  private
  public :: weight_list_t, make_weight_list, take_moments, list_inertia, inertia_of_list, axis_weights, basis_of_word, basis_words, support_width, spline_degree, &
    kernel_of, is_sampled
  public :: basis_linear, basis_ugimp, basis_cpgimp, basis_bspline2, basis_bspline3, basis_cpdi, basis_gauss, basis_ddmp, basis_cpdi2, longest_half, narrow_half, most_nodes
  public :: kernel_points, kernel_dual

  integer, parameter :: basis_linear = 1, basis_ugimp = 2, basis_cpgimp = 3, basis_bspline2 = 4, basis_bspline3 = 5, &
    basis_cpdi = 6, basis_gauss = 7, basis_ddmp = 8, basis_cpdi2 = 9
  character(len=*), parameter :: basis_words = "linear ugimp cpgimp bspline2 bspline3 cpdi gauss_gimp ddmp cpdi2"
  integer, parameter :: kernel_points = 5, kernel_dual = 6 !! the fast kernels: 2, 3, 4 nodes an axis; points; dual domains
  real(wp), parameter :: narrow_half = 0.5_wp !! up to this half length a GIMP support has 3 nodes an axis
  real(wp), parameter :: longest_half = 2.0_wp !! domains are clamped to this half length [cells]
  real(wp), parameter :: point_half = 1.0e-6_wp !! below this the exact form cancels: take the tent
  integer, parameter :: most_axis = 6 !! nodes along an axis that the longest domain touches
  integer, parameter :: most_nodes = most_axis**3

  !> Nodes with their weights and gradients
  type :: weight_list_t
    integer :: n = 0
    integer :: node(3, most_nodes) !! relative to the origin that positions refer to
    real(wp) :: s(most_nodes)
    real(wp) :: g(3, most_nodes) !! [1/spacing]
  end type weight_list_t

contains

  !> Number of a basis from its word in the scene, 0 if there is none
  pure integer function basis_of_word(word) result(basis)
    character(len=*), intent(in) :: word
    select case (word)
    case ("linear"); basis = basis_linear
    case ("ugimp"); basis = basis_ugimp
    case ("cpgimp"); basis = basis_cpgimp
    case ("bspline2"); basis = basis_bspline2
    case ("bspline3"); basis = basis_bspline3
    case ("cpdi"); basis = basis_cpdi
    case ("gauss_gimp"); basis = basis_gauss
    case ("ddmp"); basis = basis_ddmp
    case ("cpdi2"); basis = basis_cpdi2
    case default; basis = 0
    end select
  end function basis_of_word

  !> Whether the basis samples its domains at points (see gimp_point_domains)
  pure logical function is_sampled(basis)
    integer, intent(in) :: basis
    is_sampled = basis == basis_cpdi .or. basis == basis_gauss .or. basis == basis_cpdi2
  end function is_sampled

  !> Which of the fast kernels serves a basis
  pure integer function kernel_of(basis)
    integer, intent(in) :: basis
    kernel_of = merge(kernel_points, support_width(basis), is_sampled(basis))
    if (basis == basis_ddmp) kernel_of = kernel_dual
  end function kernel_of

  !> Nodes along an axis of a narrow support
  pure integer function support_width(basis)
    integer, intent(in) :: basis
    support_width = 3
    if (basis == basis_linear) support_width = 2
    if (basis == basis_bspline3 .or. basis == basis_ddmp) support_width = 4
  end function support_width

  !> Degree of a basis that is a spline, 0 for the others
  pure integer function spline_degree(basis)
    integer, intent(in) :: basis
    spline_degree = 0
    if (basis == basis_bspline2) spline_degree = 2
    if (basis == basis_bspline3) spline_degree = 3
  end function spline_degree

  !> Antiderivative of the unit tent (half width 1) with value 0 at 0
  pure real(wp) function tent_integral(x)
    real(wp), intent(in) :: x
    real(wp) :: c
    c = min(1.0_wp, max(-1.0_wp, x))
    tent_integral = c - sign(0.5_wp, c)*c*c
  end function tent_integral

  pure real(wp) function tent(x)
    real(wp), intent(in) :: x
    tent = max(0.0_wp, 1.0_wp - abs(x))
  end function tent

  !> Weights along one axis for a domain [x - half, x + half]; half = 0 gives the tent (Bardenhagen & Kober 2004; the exact
  !> form for any half length). Cells are half open: a point on a node belongs to the cell above it.
  pure subroutine axis_weights(x, half, first, n, s, g)
    real(wp), intent(in) :: x, half !! position and half length [cells]
    integer, intent(out) :: first, n !! nodes first .. first + n - 1
    real(wp), intent(out) :: s(most_axis), g(most_axis)
    real(wp) :: d
    integer :: k
    s = 0.0_wp
    g = 0.0_wp
    if (half < point_half) then
      first = floor(x)
      n = 2
      d = x - first
      s(:2) = [1.0_wp - d, d]
      g(:2) = [-1.0_wp, 1.0_wp]
      return
    end if
    first = floor(x - half)
    n = floor(x + half) + 2 - first
    do k = 1, n
      d = x - (first + k - 1)
      s(k) = (tent_integral(d + half) - tent_integral(d - half))/(2.0_wp*half)
      g(k) = (tent(d + half) - tent(d - half))/(2.0_wp*half)
    end do
  end subroutine axis_weights

  !> Weights along axis k of any basis
  pure subroutine weights_along(k, x, half, spline, first, n, s, g)
    integer, intent(in) :: k
    real(wp), intent(in) :: x, half !! [cells]
    type(spline_t), intent(in) :: spline
    integer, intent(out) :: first, n
    real(wp), intent(out) :: s(most_axis), g(most_axis)
    if (spline%degree > 0) then
      call spline_weights(spline, k, x, first, n, s, g)
    else
      call axis_weights(x, half, first, n, s, g)
    end if
  end subroutine weights_along

  !> The weight list of one particle: tensor product of the axes
  pure subroutine make_weight_list(dim, x, half, spline, list)
    integer, intent(in) :: dim
    real(wp), intent(in) :: x(:), half(:) !! (dim) [cells]; splines do not read half
    type(spline_t), intent(in) :: spline
    type(weight_list_t), intent(inout) :: list
    real(wp) :: s(most_axis, 3), g(most_axis, 3)
    integer :: first(3), n(3), i, j, k
    first = 0
    n = 1
    s = 0.0_wp
    s(1, :) = 1.0_wp
    g = 0.0_wp
    do k = 1, dim
      call weights_along(k, x(k), half(k), spline, first(k), n(k), s(:, k), g(:, k))
    end do
    list%n = 0
    do k = 1, n(3)
      do j = 1, n(2)
        do i = 1, n(1)
          list%n = list%n + 1
          list%node(:, list%n) = first + [i, j, k] - 1
          list%s(list%n) = s(i, 1)*s(j, 2)*s(k, 3)
          list%g(:, list%n) = [g(i, 1)*s(j, 2)*s(k, 3), s(i, 1)*g(j, 2)*s(k, 3), s(i, 1)*s(j, 2)*g(k, 3)]
        end do
      end do
    end do
  end subroutine make_weight_list

  !> Turn the gradients of a list into moments S (x_i - x_p) [cells], which affine transfers use in their place
  pure subroutine take_moments(dim, x, spline, list)
    integer, intent(in) :: dim
    real(wp), intent(in) :: x(:) !! (dim) [cells]
    type(spline_t), intent(in) :: spline
    type(weight_list_t), intent(inout) :: list
    integer :: i, k
    do i = 1, list%n
      do k = 1, dim
        list%g(k, i) = list%s(i)*(node_place(spline, k, list%node(k, i)) - x(k))
      end do
    end do
  end subroutine take_moments

  !> Inertia D_kk = sum S (x_i - x_p)_k^2 [cells^2] of a particle (Jiang et al. 2015); off-diagonal terms vanish, since the
  !> weights are products that reproduce linear fields
  pure function list_inertia(dim, x, half, spline) result(inertia)
    integer, intent(in) :: dim
    real(wp), intent(in) :: x(:), half(:) !! (dim) [cells]; splines do not read half
    type(spline_t), intent(in) :: spline
    real(wp) :: inertia(3)
    real(wp) :: s(most_axis), g(most_axis)
    integer :: first, n, k, i
    inertia = 1.0_wp
    do k = 1, dim
      call weights_along(k, x(k), half(k), spline, first, n, s, g)
      inertia(k) = 0.0_wp
      do i = 1, n
        inertia(k) = inertia(k) + s(i)*(node_place(spline, k, first + i - 1) - x(k))**2
      end do
    end do
  end function list_inertia

  !> Inertia D = sum S (x_i - x_p)(x_i - x_p)^T [cells^2] of any weight list
  pure function inertia_of_list(dim, x, spline, list) result(inertia)
    integer, intent(in) :: dim
    real(wp), intent(in) :: x(:) !! (dim) [cells]
    type(spline_t), intent(in) :: spline
    type(weight_list_t), intent(in) :: list
    real(wp) :: inertia(3, 3)
    real(wp) :: arm(3)
    integer :: i, k
    inertia = 0.0_wp
    arm = 0.0_wp
    do i = 1, list%n
      do k = 1, dim
        arm(k) = node_place(spline, k, list%node(k, i)) - x(k)
      end do
      do k = 1, dim
        inertia(:, k) = inertia(:, k) + list%s(i)*arm*arm(k)
      end do
    end do
  end function inertia_of_list

end module gimp_basis
