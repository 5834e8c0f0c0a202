!> The null-space filter takes what nodes do not see and nothing else
program test_null_space
  use gimp_kinds, only: wp, dp
  use gimp_basis, only: basis_linear, basis_ugimp, basis_cpgimp, basis_bspline2, basis_cpdi, basis_ddmp
  use gimp_engine, only: engine_t, pass_t
  use gimp_particle_pass, only: particle_pass
  use gimp_null_space, only: filter_velocities
  use gimp_resort, only: sort_particles
  use gimp_engine_fixture, only: cloud_t, lattice_cloud, make_engine, read_cloud, node_sums, random_reals
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  !> Directions of the range that are up to 1e-10 of the largest count for none: nodes that a domain hardly touches
  real(wp), parameter :: tolerance = 1.0e-10_wp
  integer, parameter :: bases(6) = [basis_linear, basis_ugimp, basis_cpgimp, basis_bspline2, basis_cpdi, basis_ddmp]
  integer :: seed = 11, dim, k

  call begin_suite("null space")
  do dim = 1, 3
    do k = 1, size(bases)
      call test_kept(dim, bases(k))
      call test_noise(dim, bases(k))
    end do
    call test_one_place(dim)
  end do
  call test_nothing_to_do()
  call end_suite()

contains

  !> A block of five particles an axis in each cell (four in 3D), shaken; it spans several blocks of the grid
  subroutine new_cloud(dim, per_axis, cloud)
    integer, intent(in) :: dim, per_axis
    type(cloud_t), intent(out) :: cloud
    integer, parameter :: extent(3, 3) = reshape([10, 1, 1, 10, 3, 1, 5, 2, 2], [3, 3])
    real(wp) :: u(4)
    integer :: i
    call lattice_cloud(dim, [3, 3, 3], extent(:, dim), per_axis, 0.5_wp, 1000.0_wp, cloud)
    do i = 1, cloud%n
      call random_reals(seed, u)
      cloud%x(:dim, i) = cloud%x(:dim, i) + 0.3_wp/per_axis*u(:dim)
      cloud%mass(i) = cloud%mass(i)*(1.0_wp + 0.4_wp*u(4))
    end do
  end subroutine new_cloud

  subroutine new_engine(dim, basis, cloud, engine)
    integer, intent(in) :: dim, basis
    type(cloud_t), intent(in) :: cloud
    type(engine_t), intent(out) :: engine
    integer, parameter :: cells(3, 3) = reshape([20, 1, 1, 20, 12, 1, 12, 8, 8], [3, 3])
    call make_engine(dim, basis, cells(:, dim), 0.5_wp, cloud, engine)
    call sort_particles(engine)
  end subroutine new_engine

  !> Enough particles in a cell that nodes do not see all of their velocities
  pure integer function many(dim)
    integer, intent(in) :: dim
    many = merge(4, 5, dim == 3)
  end function many

  !> Constant and linear fields stay as they are
  subroutine test_kept(dim, basis)
    integer, intent(in) :: dim, basis
    type(engine_t), target :: engine
    type(cloud_t) :: cloud, after
    real(wp) :: a(3, 3), v0(3)
    real(dp) :: taken
    integer :: i
    call new_cloud(dim, many(dim), cloud)
    a = 0.0_wp
    v0 = 0.0_wp
    do i = 1, dim
      call random_reals(seed, a(:dim, i))
    end do
    call random_reals(seed, v0(:dim))
    do i = 1, cloud%n
      cloud%v(:, i) = v0 + matmul(a, cloud%x(:, i))
    end do
    call new_engine(dim, basis, cloud, engine)
    call filter_velocities(engine, taken)
    call read_cloud(engine, after)
    call check(maxval(abs(after%v - cloud%v))/maxval(abs(cloud%v)), 0.0_wp, tolerance, "a linear field"//which(dim, basis))
    call check(taken/sum(cloud%mass*sum(cloud%v**2, dim=1)), 0.0_dp, 1.0e-12_dp, "costs nothing"//which(dim, basis))
  end subroutine test_kept

  !> Of random velocities nodes see the same as before, particles lose energy, and a second filter finds nothing
  subroutine test_noise(dim, basis)
    integer, intent(in) :: dim, basis
    type(engine_t), target :: engine
    type(cloud_t) :: cloud, after, again
    real(wp), allocatable :: seen(:, :, :), seen_after(:, :, :)
    real(dp) :: taken, more
    integer :: i
    call new_cloud(dim, many(dim), cloud)
    do i = 1, cloud%n
      call random_reals(seed, cloud%v(:dim, i))
    end do
    call new_engine(dim, basis, cloud, engine)
    call particle_pass(engine, pass_t(momentum=.true.))
    call node_sums(engine, seen)
    call filter_velocities(engine, taken)
    call read_cloud(engine, after)
    call particle_pass(engine, pass_t(momentum=.true.))
    call node_sums(engine, seen_after)
    call check(maxval(abs(seen_after(:4, :, :) - seen(:4, :, :)))/maxval(abs(seen(:4, :, :))), 0.0_wp, tolerance, "momentum of nodes"//which(dim, basis))
    call check_true(taken > 0.1_dp*energy_of(cloud), "noise goes"//which(dim, basis))
    call check(taken/energy_of(cloud), (energy_of(cloud) - energy_of(after))/energy_of(cloud), 1.0e-13_dp, "as much as is counted"//which(dim, basis))
    do i = 1, dim
      call check(sum(after%mass*after%v(i, :)), sum(cloud%mass*cloud%v(i, :)), 1.0e-13_wp*sum(cloud%mass), "momentum"//which(dim, basis))
    end do
    if (dim > 1) call check(spin_of(after), spin_of(cloud), 1.0e-11_wp*sum(cloud%mass), "angular momentum"//which(dim, basis))
    call filter_velocities(engine, more)
    call read_cloud(engine, again)
    call check(maxval(abs(again%v - after%v)), 0.0_wp, tolerance, "a second filter"//which(dim, basis))
  end subroutine test_noise

  !> Many particles at one place: the rank is one, all get the mean
  subroutine test_one_place(dim)
    integer, intent(in) :: dim
    type(engine_t), target :: engine
    type(cloud_t) :: cloud, after
    real(dp) :: taken
    integer :: i
    call new_cloud(dim, 2, cloud)
    do i = 1, cloud%n
      cloud%x(:dim, i) = 4.3_wp
      call random_reals(seed, cloud%v(:dim, i))
    end do
    call new_engine(dim, basis_linear, cloud, engine)
    call filter_velocities(engine, taken)
    call read_cloud(engine, after)
    do i = 1, dim
      call check(maxval(abs(after%v(i, :) - sum(cloud%mass*cloud%v(i, :))/sum(cloud%mass))), 0.0_wp, tolerance, "one place, "//text_of(dim)//"D")
    end do
  end subroutine test_one_place

  !> Two particles an axis and tents: nodes see everything, not a bit changes
  subroutine test_nothing_to_do()
    type(engine_t), target :: engine
    type(cloud_t) :: cloud, after
    real(dp) :: taken
    integer :: i
    call new_cloud(2, 2, cloud)
    do i = 1, cloud%n
      call random_reals(seed, cloud%v(:2, i))
    end do
    call new_engine(2, basis_linear, cloud, engine)
    call filter_velocities(engine, taken)
    call read_cloud(engine, after)
    call check_true(all(after%v == cloud%v) .and. taken == 0.0_dp, "four particles and four nodes: nothing is hidden")
  end subroutine test_nothing_to_do

  function which(dim, basis) result(text)
    integer, intent(in) :: dim, basis
    character(len=:), allocatable :: text
    text = ", "//text_of(dim)//"D, basis "//text_of(basis)
  end function which

  pure real(dp) function energy_of(cloud)
    type(cloud_t), intent(in) :: cloud
    energy_of = 0.5_dp*sum(real(cloud%mass, dp)*sum(real(cloud%v, dp)**2, dim=1))
  end function energy_of

  !> About the z axis through the corner of the box
  pure real(wp) function spin_of(cloud)
    type(cloud_t), intent(in) :: cloud
    spin_of = sum(cloud%mass*(cloud%x(1, :)*cloud%v(2, :) - cloud%x(2, :)*cloud%v(1, :)))
  end function spin_of

end program test_null_space
