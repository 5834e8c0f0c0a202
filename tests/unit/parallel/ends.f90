!> How ranks end: `ends CODE together` all with that exit code, `ends CODE one` the last rank alone while the others wait for it
program ends
  use gimp_ranks, only: this_rank, ranks, start_ranks, end_ranks, end_all_ranks, wait_for_ranks
  use, intrinsic :: iso_fortran_env, only: output_unit
  implicit none(type, external)
  character(len=8) :: word(2)
  integer :: code

  call start_ranks()
  call get_command_argument(1, word(1))
  call get_command_argument(2, word(2))
  read (word(1), *) code
  write (output_unit, "(a,i0)") "last words of rank ", this_rank ! written out by whoever ends the program
  if (word(2) == "together") call end_ranks(code)
  if (this_rank == ranks - 1) call end_all_ranks(code)
  call wait_for_ranks()
end program ends
