!> What a mesh holds, in one number: the same for files that give the same mesh, whatever they are called
module gimp_mesh_content
  use gimp_kinds, only: dp, i8
  use gimp_hash_table, only: mix_bits
  use gimp_mesh, only: mesh_t, kind_nodes
  use gimp_grid, only: grid_t
  use gimp_setup_sides, only: no_name
  implicit none(type, external)
  private
  public :: mesh_hash

contains

  !> Nodes, elements and groups by the numbers of the file, so that it does not matter how the program orders them
  pure function mesh_hash(mesh, grid) result(text)
    type(mesh_t), intent(in) :: mesh
    type(grid_t), intent(in) :: grid !! the box around it
    character(len=16) :: text
    integer(i8) :: hash, item
    integer :: i, k
    hash = numbers_hash(transfer([grid%lower, grid%spacing], [0_i8]))
    do i = 1, mesh%nodes
      item = numbers_hash([1_i8, int(mesh%node_in_file(i), i8), transfer(real(mesh%x(:, i), dp), [0_i8])])
      hash = hash + item
    end do
    do i = 1, mesh%elements
      associate (node => mesh%node(:kind_nodes(mesh%kind(i)), i))
        item = numbers_hash(int([2, mesh%kind(i), mesh%element_in_file(i), mesh%element_group(i), mesh%node_in_file(node)], i8))
      end associate
      hash = hash + item
    end do
    do i = 1, size(mesh%named_side_group)
      item = 0
      do k = 1, size(mesh%named_side_node, 1)
        if (mesh%named_side_node(k, i) > 0) item = item + mix_bits(int(mesh%node_in_file(mesh%named_side_node(k, i)), i8))
      end do
      hash = hash + numbers_hash([3_i8, int(mesh%named_side_group(i), i8), item])
    end do
    do i = 1, size(mesh%element_group_name)
      hash = hash + numbers_hash([4_i8, int(i, i8), letters(mesh%element_group_name(i))])
    end do
    do i = 1, size(mesh%side_group_name)
      if (mesh%side_group_name(i) == no_name) cycle
      hash = hash + numbers_hash([5_i8, int(i, i8), letters(mesh%side_group_name(i))])
    end do
    write (text, "(z16.16)") hash
  end function mesh_hash

  pure integer(i8) function numbers_hash(numbers) result(hash)
    integer(i8), intent(in) :: numbers(:)
    integer :: k
    hash = 0
    do k = 1, size(numbers)
      hash = mix_bits(ieor(hash, numbers(k)) + k) ! k: a zero must change it
    end do
  end function numbers_hash

  pure function letters(name) result(numbers)
    character(len=*), intent(in) :: name
    integer(i8) :: numbers(len_trim(name))
    integer :: k
    numbers = [(int(iachar(name(k:k)), i8), k=1, len_trim(name))]
  end function letters

end module gimp_mesh_content
