!> Stress for the eye: mapped to the nodes and back (Andersen & Andersen 2010), sigma_i = sum m S sigma/m_i, then sum S sigma_i at
!> the particles. A run does not feel it: pads, nodal values and books are as before.
module gimp_smoothed_stress
  use gimp_kinds, only: wp, lanes
  use gimp_grid, only: grid_t, nodes_per_block, nf => fields_per_node, node_mass, has_images
  use gimp_blocks, only: few_blocks
  use gimp_images, only: image_t, fold_images, copy_images
  use gimp_engine, only: engine_t, pass_t
  use gimp_aside, only: aside_t, put_aside, bring_back
  use gimp_pads, only: sum_pads, add_spills
  use gimp_particle_pass, only: particle_pass
  implicit none(type, external)
  private
  public :: smooth_stress

contains

  !> Smoothed Cauchy stress of all particles of this rank [Pa], by the weights of their present positions. Collective
  subroutine smooth_stress(engine, smoothed)
    type(engine_t), intent(inout) :: engine
    real(wp), allocatable, intent(out) :: smoothed(:, :, :) !! (lane, component, chunk)
    real(wp), pointer, contiguous :: g(:, :, :)
    type(aside_t) :: aside
    call put_aside(engine, aside)
    g => engine%g
    allocate (engine%g(nf, nodes_per_block, engine%table%slots))
    allocate (engine%smoothed(lanes, 6, engine%particles%chunks), source=0.0_wp)
    call particle_pass(engine, pass_t(stress_give=.true., old_weights=.true.))
    call mean_of_nodes(engine)
    call particle_pass(engine, pass_t(stress_take=.true.))
    deallocate (engine%g)
    engine%g => g
    call bring_back(engine, aside)
    call move_alloc(engine%smoothed, smoothed)
  end subroutine smooth_stress

  !> Divide what nodes were given by their masses. A mirror turns the shear of its normal around, and in its plane there is none.
  subroutine mean_of_nodes(engine)
    type(engine_t), intent(inout) :: engine
    type(image_t), allocatable :: images(:)
    integer :: i, k, slot
    !$omp parallel do schedule(static) if(engine%table%slots > few_blocks)
    do slot = 1, engine%table%slots
      call sum_pads(engine, slot, engine%g(:, :, slot))
    end do
    !$omp end parallel do
    call add_spills(engine, engine%table%slots, engine%g)
    images = engine%images
    do k = 1, size(images)
      associate (s => engine%images(k)%sign(:3))
        images(k)%sign = [1.0_wp, 1.0_wp, 1.0_wp, 1.0_wp, s(1)*s(2), s(2)*s(3), s(3)*s(1), 1.0_wp]
      end associate
    end do
    if (has_images(engine%grid)) call fold_images(images, engine%table%slots, engine%g)
    !$omp parallel do schedule(static) private(i) if(engine%table%slots > few_blocks)
    do slot = 1, engine%table%slots
      do i = 1, nodes_per_block
        if (engine%g(node_mass, i, slot) > 0.0_wp) engine%g(:, i, slot) = engine%g(:, i, slot)/engine%g(node_mass, i, slot)
      end do
      call clear_mirrors(engine%grid, engine%table%slot_at(:, slot), engine%g(:, :, slot))
    end do
    !$omp end parallel do
    if (has_images(engine%grid)) call copy_images(images, engine%table%slots, engine%g)
  end subroutine mean_of_nodes

  !> No shear in planes of symmetry
  pure subroutine clear_mirrors(grid, at, g)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: at(3) !! block coordinates of the slot
    real(wp), intent(inout) :: g(nf, nodes_per_block)
    integer :: i, node(3)
    logical :: on(3)
    if (.not. (any(grid%mirror_low) .or. any(grid%mirror_high))) return
    do i = 0, nodes_per_block - 1
      node = at*grid%edge + [modulo(i, grid%edge(1)), modulo(i/grid%edge(1), grid%edge(2)), i/(grid%edge(1)*grid%edge(2))]
      on = (grid%mirror_low .and. node == 0) .or. (grid%mirror_high .and. node == grid%cells)
      if (on(1) .or. on(2)) g(5, i + 1) = 0.0_wp
      if (on(2) .or. on(3)) g(6, i + 1) = 0.0_wp
      if (on(3) .or. on(1)) g(7, i + 1) = 0.0_wp
    end do
  end subroutine clear_mirrors

end module gimp_smoothed_stress
