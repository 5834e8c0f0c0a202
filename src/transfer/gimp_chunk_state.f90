!> What is read off the particles chunk by chunk: the full deformation gradient, and the elastic energy of them all
module gimp_chunk_state
  use gimp_kinds, only: wp, dp, lanes
  use gimp_over_ranks, only: sum_of
  use gimp_particles, only: particles_t
  use gimp_material, only: most_states, load_history
  use gimp_engine, only: engine_t
  implicit none(type, external)
  private
  public :: chunk_deformation, chunk_law_deformation, chunk_history, elastic_energy_of, elastic_round_off

contains

  !> Full deformation gradient of a chunk
  pure subroutine chunk_deformation(particles, c, f)
    type(particles_t), intent(in) :: particles
    integer, intent(in) :: c !! chunk
    real(wp), intent(out) :: f(lanes, 9)
    call read_deformation(particles, c, particles%deformation%first, f)
  end subroutine chunk_deformation

  !> The one that laws see: the same, unless its changes of volume are averaged over cells
  pure subroutine chunk_law_deformation(particles, c, f)
    type(particles_t), intent(in) :: particles
    integer, intent(in) :: c !! chunk
    real(wp), intent(out) :: f(lanes, 9)
    call read_deformation(particles, c, max(particles%deformation%first, particles%evened%first), f)
  end subroutine chunk_law_deformation

  pure subroutine read_deformation(particles, c, first, f)
    type(particles_t), intent(in) :: particles
    integer, intent(in) :: c, first !! chunk, first component
    real(wp), intent(out) :: f(lanes, 9)
    integer :: i, j
    f = 0.0_wp
    f(:, 1) = 1.0_wp
    f(:, 5) = 1.0_wp
    f(:, 9) = 1.0_wp
    do i = 1, particles%dim
      do j = 1, particles%dim
        f(:, 3*(i - 1) + j) = particles%p(:, first + particles%dim*(i - 1) + j - 1, c)
      end do
    end do
  end subroutine read_deformation

  !> The whole history of a chunk's material
  pure subroutine chunk_history(particles, c, history)
    type(particles_t), intent(in) :: particles
    integer, intent(in) :: c !! chunk
    real(wp), intent(out) :: history(lanes, most_states)
    integer :: first
    first = max(1, particles%state%first)
    call load_history(particles%state%components, particles%p(:, first:first + particles%state%components - 1, c), history)
  end subroutine chunk_history

  !> Elastic energy of all particles [J], summed per group first. Collective
  real(dp) function elastic_energy_of(engine)
    type(engine_t), intent(in) :: engine
    real(wp) :: f(lanes, 9), history(lanes, most_states), energy(lanes)
    real(dp) :: part(size(engine%particles%groups))
    integer :: g, c, l
    associate (particles => engine%particles)
      !$omp parallel do schedule(static) private(c, l, f, history, energy)
      do g = 1, size(particles%groups)
        part(g) = 0.0_dp
        do c = particles%groups(g)%first, particles%groups(g)%last
          call chunk_law_deformation(particles, c, f)
          call chunk_history(particles, c, history)
          call engine%laws(particles%groups(g)%material)%law%stored_energy(f, history, energy)
          do l = 1, lanes
            part(g) = part(g) + real(particles%p(l, particles%volume%first, c), dp)*real(energy(l), dp)
          end do
        end do
      end do
      !$omp end parallel do
    end associate
    elastic_energy_of = sum_of(part)
  end function elastic_energy_of

  !> Round-off of that energy [J]: laws take differences of numbers of the size of their modulus. Collective
  real(dp) function elastic_round_off(engine) result(energy)
    type(engine_t), intent(in) :: engine
    real(dp) :: part(size(engine%particles%groups))
    integer :: g
    associate (particles => engine%particles)
      do g = 1, size(particles%groups)
        associate (law => engine%laws(particles%groups(g)%material)%law, first => particles%groups(g)%first, &
                   last => particles%groups(g)%last)
          part(g) = 16.0_dp*epsilon(1.0_wp)*(law%lambda + 2.0_wp*law%mu) &
            *sum(real(particles%p(:, particles%volume%first, first:last), dp))
        end associate
      end do
    end associate
    energy = sum_of(part)
  end function elastic_round_off

end module gimp_chunk_state
