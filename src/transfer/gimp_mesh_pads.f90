!> What the chosen basis asks of an unstructured mesh: how far the pads of its patches reach, the points of its particles, and what dual
!> domains smear.
module gimp_mesh_pads
  use gimp_basis, only: basis_ddmp, is_sampled
  use gimp_kinds, only: wp
  use gimp_patches, only: make_pads
  use gimp_mesh_dual, only: smear_gradients
  use gimp_point_domains, only: volume_rule
  use gimp_engine, only: engine_t
  implicit none(type, external)
  private
  public :: prepare_mesh

contains

  !> Once the mesh is connected and cut into patches, and basis, rule and longest domain are known
  subroutine prepare_mesh(engine)
    type(engine_t), intent(inout) :: engine
    real(wp) :: reach
    integer :: rings
    reach = 0.0_wp
    rings = 0
    if (is_sampled(engine%basis)) then
      reach = engine%longest_diagonal
    else
      engine%rule = volume_rule(engine%grid%dim, 1) ! particles are points, with gradients there
    end if
    if (engine%basis == basis_ddmp) then
      rings = 1
      call smear_gradients(engine%mesh, engine%smear)
    end if
    call make_pads(engine%mesh, engine%patches, reach, rings)
  end subroutine prepare_mesh

end module gimp_mesh_pads
