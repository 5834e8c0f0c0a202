!> The smeared gradients of the dual domain method on a mesh (Zhang, Ma & Giguere 2011): at every node j the mean gradient of the shape
!> functions around it, Gbar_ji = int N_j grad N_i dV / int N_j dV. Linear elements only: the quadratic ones have shape functions
!> with integrals of both signs.
module gimp_mesh_dual
  use gimp_kinds, only: wp
  use gimp_mesh, only: mesh_t, kind_dim, kind_nodes, kind_corners
  use gimp_elements, only: shape_values, shape_slopes
  implicit none(type, external)
  private
  public :: smear_t, smear_gradients

  type :: smear_t
    integer, allocatable :: first(:) !! (node + 1) where its neighbours begin in `node`
    integer, allocatable :: node(:) !! nodes that share an element with it, itself first
    real(wp), allocatable :: g(:, :) !! (dim, neighbour) Gbar_ji [1/cells]
  end type smear_t

contains

  !> Neighbours and smeared gradients of all nodes of a connected mesh
  subroutine smear_gradients(mesh, smear)
    type(mesh_t), intent(in) :: mesh
    type(smear_t), intent(out) :: smear
    real(wp) :: volume
    integer, allocatable :: stamp(:)
    integer :: node, n, j, e
    allocate (stamp(mesh%nodes), source=0)
    allocate (smear%first(mesh%nodes + 1), smear%node(8*mesh%nodes), smear%g(mesh%dim, 8*mesh%nodes))
    n = 0
    do node = 1, mesh%nodes
      smear%first(node) = n + 1
      call add(node)
      volume = 0.0_wp
      do j = mesh%vertex_first(node), mesh%vertex_first(node + 1) - 1
        e = mesh%vertex_element(j)
        call add_element()
      end do
      if (volume > 0.0_wp) smear%g(:, smear%first(node):n) = smear%g(:, smear%first(node):n)/volume
    end do
    smear%first(mesh%nodes + 1) = n + 1
    smear%node = smear%node(:n)
    smear%g = smear%g(:, :n)

  contains

    subroutine add(neighbour)
      integer, intent(in) :: neighbour
      real(wp), allocatable :: wider(:, :)
      if (stamp(neighbour) >= smear%first(node)) return
      n = n + 1
      if (n > size(smear%node)) then
        smear%node = [smear%node, smear%node]
        allocate (wider(mesh%dim, size(smear%node)))
        wider(:, :n - 1) = smear%g(:, :n - 1)
        call move_alloc(wider, smear%g)
      end if
      stamp(neighbour) = n
      smear%node(n) = neighbour
      smear%g(:, n) = 0.0_wp
    end subroutine add

    !> What element e adds to the integrals of `node`: two Gauss points an axis, exact for simplices by their centroids alone
    subroutine add_element()
      real(wp) :: xe(mesh%dim, 8), values(8), slopes(mesh%dim, 8), xi(mesh%dim), jacobian(mesh%dim, mesh%dim), weight
      real(wp), parameter :: gauss = 1.0_wp/sqrt(3.0_wp)
      integer :: q, i, k, own, points, m
      m = kind_nodes(mesh%kind(e))
      xe(:, :m) = mesh%x(:, mesh%node(:m, e))
      own = findloc(mesh%node(:m, e), node, dim=1)
      points = 2**mesh%dim
      if (kind_corners(mesh%kind(e)) == mesh%dim + 1 .and. mesh%dim > 1) points = 1
      do q = 1, points
        if (points == 1) then
          xi = 1.0_wp/(mesh%dim + 1)
          weight = 1.0_wp/product([(i, i=1, mesh%dim)])
        else
          xi = [(merge(gauss, -gauss, btest(q - 1, k - 1)), k=1, mesh%dim)]
          weight = 1.0_wp
        end if
        call shape_values(mesh%kind(e), xi, values(:m))
        call shape_slopes(mesh%kind(e), xi, slopes(:, :m))
        jacobian = matmul(xe(:, :m), transpose(slopes(:, :m))) ! dx_r/dxi_k
        call add_gradients(jacobian, slopes(:, :m), weight*values(own))
      end do
    end subroutine add_element

    subroutine add_gradients(jacobian, slopes, weight)
      real(wp), intent(in) :: jacobian(:, :), slopes(:, :), weight
      real(wp) :: adjugate(mesh%dim, mesh%dim), det
      integer :: i
      call adjugate_of(jacobian, adjugate, det)
      volume = volume + weight*det
      do i = 1, size(slopes, 2)
        call add(mesh%node(i, e))
        associate (here => smear%g(:, stamp(mesh%node(i, e))))
          here = here + weight*matmul(slopes(:, i), adjugate) ! grad N = J^-T dN/dxi, times det J
        end associate
      end do
    end subroutine add_gradients

  end subroutine smear_gradients

  !> det(a) a^-1, and det(a)
  pure subroutine adjugate_of(a, adjugate, det)
    real(wp), intent(in) :: a(:, :)
    real(wp), intent(out) :: adjugate(:, :), det
    integer :: i, j
    select case (size(a, 1))
    case (1)
      adjugate = 1.0_wp
    case (2)
      adjugate(1, :) = [a(2, 2), -a(1, 2)]
      adjugate(2, :) = [-a(2, 1), a(1, 1)]
    case default
      do i = 1, 3
        do j = 1, 3
          associate (p => modulo(j, 3) + 1, q => modulo(j + 1, 3) + 1, r => modulo(i, 3) + 1, s => modulo(i + 1, 3) + 1)
            adjugate(i, j) = a(p, r)*a(q, s) - a(p, s)*a(q, r)
          end associate
        end do
      end do
    end select
    det = dot_product(a(1, :), adjugate(:, 1))
  end subroutine adjugate_of

end module gimp_mesh_dual
