!> What cells know of their particles: rates of volume before strains, stresses before forces
module gimp_cell_pass
  use gimp_kinds, only: wp, lanes
  use gimp_tensor, only: determinant
  use gimp_material, only: most_states
  use gimp_engine, only: engine_t, pass_t, offer_tasks, take_task, anti_f_bar, anti_b_bar, anti_cell_stress
  use gimp_particles, only: few_chunks
  use gimp_chunk_state, only: chunk_law_deformation, chunk_history
  use gimp_cells, only: give_to_cells, sum_cells, stress_values
  use gimp_particle_pass, only: particle_pass, allot_spills, tell_signs, complete_pads
  use gimp_list_kernel, only: order_spill
  use gimp_borders, only: send_pads
  implicit none(type, external)
  private
  public :: evens_strain, evens_stress, rates_to_cells, stress_to_cells

contains

  !> Whether strains need sums over cells
  pure logical function evens_strain(engine)
    type(engine_t), intent(in) :: engine
    evens_strain = engine%anti_locking == anti_f_bar .or. engine%anti_locking == anti_b_bar
  end function evens_strain

  !> Whether forces need sums over cells
  pure logical function evens_stress(engine)
    type(engine_t), intent(in) :: engine
    evens_stress = engine%anti_locking == anti_cell_stress .or. engine%anti_locking == anti_b_bar
  end function evens_stress

  !> Volumes and their change in the step, for the strains of `pass`, which comes next; pads are used up
  subroutine rates_to_cells(engine, pass)
    type(engine_t), intent(inout) :: engine
    type(pass_t), intent(in) :: pass
    call particle_pass(engine, pass_t(cells=.true., dt_strain=pass%dt_strain))
    call sum_cells(engine)
  end subroutine rates_to_cells

  !> Volumes and stresses at the present positions, for the force that comes next; pads are used up
  subroutine stress_to_cells(engine)
    type(engine_t), intent(inout) :: engine
    integer :: i, t
    call allot_spills(engine)
    call offer_tasks(engine, 1, engine%table%blocks)
    !$omp parallel private(i, t) if(engine%particles%chunks > few_chunks)
    do
      call take_task(engine, t)
      if (t == 0) exit
      do i = engine%task(t), engine%task(t + 1) - 1
        call stress_of_block(engine, engine%order(i))
      end do
    end do
    !$omp end parallel
    call order_spill(engine%spilled, engine%spill)
    call tell_signs(engine)
    call send_pads(engine, .true.)
    call complete_pads(engine, .true.)
    call sum_cells(engine)
  end subroutine stress_to_cells

  subroutine stress_of_block(engine, b)
    type(engine_t), intent(inout) :: engine
    integer, intent(in) :: b
    real(wp) :: f(lanes, 9), history(lanes, most_states), tau(lanes, 6), speed2(lanes), j(lanes), values(lanes, 8)
    integer :: c, g
    engine%pad(:, :, b) = 0.0_wp
    do g = engine%particles%block_group(b), engine%particles%block_group(b + 1) - 1
      associate (group => engine%particles%groups(g), p => engine%particles)
        do c = group%first, group%last
          call chunk_law_deformation(p, c, f)
          call chunk_history(p, c, history)
          call engine%laws(group%material)%law%kirchhoff(f, history, tau, speed2)
          call determinant(f, j)
          call stress_values(p%dim, engine%anti_locking == anti_cell_stress, p%p(:, p%volume%first, c), j, tau, values)
          call give_to_cells(engine, b, p%p(:, :p%dim, c), values, engine%pad(:, :, b))
        end do
      end associate
    end do
  end subroutine stress_of_block

end module gimp_cell_pass
