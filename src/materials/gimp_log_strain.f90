!> What the models on logarithmic elastic strain share: trial strain, elasticity, storage, bound of the wave speed.
!>
!> Kinematics (Simo 1992; de Souza Neto, Peric & Owen 2008, ch. 14): the elastic left Cauchy-Green tensor b_e is pushed
!> forward, b_tr = dF b_e dF^T; the trial strain e = 1/2 ln b_tr is returned to the yield surface in principal axes as at
!> small strain; b_e = exp(2 e) keeps the eigenvectors. Elasticity (Hencky): tau = lambda tr(e) I + 2 mu e.
module gimp_log_strain
  use gimp_kinds, only: wp, lanes
  use gimp_tensor, only: push_forward, left_cauchy_green, eigen_symmetric, compose, natural_log, exponential, determinant
  implicit none(type, external)
  private
  public :: plastic_states, at_plastic_strain, at_stress
  public :: principal_strain, trial_strain, starting_strain, keep_state, kirchhoff_of_strain, elastic_energy, wave_bound

  !> History of the plastic models: b_e, equivalent plastic strain, Kirchhoff stress. The stress is stored although b_e
  !> implies it: recomputing it costs a second spectral decomposition per step, six numbers of memory do not.
  integer, parameter :: plastic_states = 13
  integer, parameter :: at_plastic_strain = 7 !! where the equivalent plastic strain sits
  integer, parameter :: at_stress = 7 !! the six stress components follow this one

contains

  !> e = 1/2 ln b in principal axes
  pure subroutine principal_strain(b, e, n)
    real(wp), intent(in) :: b(lanes, 6)
    real(wp), intent(out) :: e(lanes, 3) !! principal logarithmic strains
    real(wp), intent(out) :: n(lanes, 9) !! their directions, as columns
    integer :: c, k
    call eigen_symmetric(b, e, n)
    do c = 1, 3
      call natural_log(e(:, c))
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        e(k, c) = 0.5_wp*e(k, c)
      end do
    end do
  end subroutine principal_strain

  !> The strain before plastic flow
  pure subroutine trial_strain(df, state, b, e, n)
    real(wp), intent(in) :: df(lanes, 9) !! increment of the deformation gradient
    real(wp), intent(in) :: state(lanes, *) !! b_e of the old step first
    real(wp), intent(out) :: b(lanes, 6) !! trial b_e
    real(wp), intent(out) :: e(lanes, 3) !! principal logarithmic trial strains
    real(wp), intent(out) :: n(lanes, 9) !! their directions, as columns
    call push_forward(df, state, b)
    call principal_strain(b, e, n)
  end subroutine trial_strain

  !> The trial strain at t = 0: from F, or from the initial stress where one is given
  pure subroutine starting_strain(lambda, mu, f, stress, b, e, n)
    real(wp), intent(in) :: lambda, mu !! Lame constants [Pa]
    real(wp), intent(in) :: f(lanes, 9) !! deformation gradient at t = 0
    real(wp), intent(in) :: stress(lanes, 6) !! Cauchy stress at t = 0 [Pa]
    real(wp), intent(out) :: b(lanes, 6) !! trial b_e
    real(wp), intent(out) :: e(lanes, 3) !! principal logarithmic trial strains
    real(wp), intent(out) :: n(lanes, 9) !! their directions, as columns
    real(wp) :: from_stress(lanes, 6), values(lanes, 3), j(lanes), trace
    integer :: c, k
    call determinant(f, j)
    do k = 1, lanes
      trace = lambda*sum(stress(k, 1:3))/(3*lambda + 2*mu)
      from_stress(k, 1:3) = j(k)*(stress(k, 1:3) - trace)/(2*mu)
      from_stress(k, 4:6) = j(k)*stress(k, 4:6)/(2*mu)
    end do
    call eigen_symmetric(from_stress, values, n)
    do c = 1, 3
      values(:, c) = 2*values(:, c)
      call exponential(values(:, c))
    end do
    call compose(values, n, from_stress)
    call left_cauchy_green(f, b)
    do k = 1, lanes
      if (maxval(abs(stress(k, :))) > 0.0_wp) b(k, :) = from_stress(k, :)
    end do
    call principal_strain(b, e, n)
  end subroutine starting_strain

  !> Store b_e and the Kirchhoff stress that belong to the returned strain
  pure subroutine keep_state(lambda, mu, flows, b, e, n, state)
    real(wp), intent(in) :: lambda, mu !! Lame constants [Pa]
    real(wp), intent(in) :: flows(lanes) !! above zero where the return changed the strain: elsewhere b is kept as it is,
      !! because ln and exp in turn would leave a bias that grows with the number of steps
    real(wp), intent(in) :: b(lanes, 6) !! trial b_e
    real(wp), intent(in) :: e(lanes, 3) !! principal logarithmic strains after the return
    real(wp), intent(in) :: n(lanes, 9) !! their directions, as columns
    real(wp), intent(inout) :: state(lanes, *)
    real(wp) :: values(lanes, 3), returned(lanes, 6), tau(lanes, 6)
    integer :: c, k
    do c = 1, 3
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        values(k, c) = 2.0_wp*e(k, c)
      end do
      call exponential(values(:, c))
    end do
    call compose(values, n, returned)
    call kirchhoff_of_strain(lambda, mu, e, n, tau)
    do c = 1, 6
      !$omp simd simdlen(lanes)
      do k = 1, lanes
        state(k, c) = merge(returned(k, c), b(k, c), flows(k) > 0.0_wp)
        state(k, at_stress + c) = tau(k, c)
      end do
    end do
  end subroutine keep_state

  !> tau = lambda tr(e) I + 2 mu e
  pure subroutine kirchhoff_of_strain(lambda, mu, e, n, tau)
    real(wp), intent(in) :: lambda, mu !! Lame constants [Pa]
    real(wp), intent(in) :: e(lanes, 3) !! principal logarithmic strains
    real(wp), intent(in) :: n(lanes, 9) !! their directions, as columns
    real(wp), intent(out) :: tau(lanes, 6) !! Kirchhoff stress [Pa]
    real(wp) :: values(lanes, 3), volumetric
    integer :: k
    !$omp simd simdlen(lanes) private(volumetric)
    do k = 1, lanes
      volumetric = lambda*(e(k, 1) + e(k, 2) + e(k, 3))
      values(k, 1) = volumetric + 2.0_wp*mu*e(k, 1)
      values(k, 2) = volumetric + 2.0_wp*mu*e(k, 2)
      values(k, 3) = volumetric + 2.0_wp*mu*e(k, 3)
    end do
    call compose(values, n, tau)
  end subroutine kirchhoff_of_strain

  !> W = |dev tau|^2/(4 mu) + p^2/(2 K), p = tr(tau)/3: the same as mu e:e + lambda/2 tr(e)^2
  pure subroutine elastic_energy(lambda, mu, tau, energy)
    real(wp), intent(in) :: lambda, mu !! Lame constants [Pa]
    real(wp), intent(in) :: tau(lanes, 6) !! Kirchhoff stress [Pa]
    real(wp), intent(out) :: energy(lanes) !! per reference volume [J/m3]
    real(wp) :: p, shear, bulk
    integer :: k
    shear = 0.25_wp/mu
    bulk = 0.5_wp/(lambda + 2.0_wp*mu/3.0_wp)
    !$omp simd simdlen(lanes) private(p)
    do k = 1, lanes
      p = (tau(k, 1) + tau(k, 2) + tau(k, 3))/3.0_wp
      energy(k) = bulk*p*p + shear*((tau(k, 1) - p)**2 + (tau(k, 2) - p)**2 + (tau(k, 3) - p)**2 &
        + 2.0_wp*(tau(k, 4)**2 + tau(k, 5)**2 + tau(k, 6)**2))
    end do
  end subroutine elastic_energy

  !> An upper bound of the squared elastic wave speed from invariants of the stress alone
  !>
  !> In principal axes the acoustic tensor of an isotropic law (Ogden 1984, ch. 6), times the current volume ratio, gives for
  !> direction n and polarisation m (both unit vectors)
  !>   m.Q m = lambda (m.n)^2 + sum_i (2 mu - t_i) m_i^2 n_i^2 + sum_{i/=j} [g_ij m_i n_i m_j n_j + s_ij m_i^2 n_j^2],
  !>   s_ij = (t_i - t_j) b_j/(b_i - b_j) = mu ln r/(r - 1), r = b_i/b_j;  g_ij = s_ij - t_j = s_ji - t_i.
  !> The numbers m_i n_j have the norm 1, so the last two sums are at most the largest of 2 mu - t_i and of the eigenvalues of
  !> the pairs, M_ij + sqrt(((t_i - t_j)/2)^2 + g_ij^2), M_ij = (s_ij + s_ji)/2 = mu (x/2) coth(x/2) with x = |ln r|, between
  !> mu and mu (1 + min(x^2/12, x/2)). With |dev t| the norm of the deviator: x <= sqrt(2) |dev t|/mu,
  !> |t_i - t_j| <= sqrt(2) |dev t|, |g_ij| <= |M_ij - p| + |dev t|/sqrt(6), |t_i - p| <= sqrt(2/3) |dev t|.
  !> Exact, lambda + 2 mu, without stress.
  pure subroutine wave_bound(lambda, mu, density, tau, speed2)
    real(wp), intent(in) :: lambda, mu !! Lame constants [Pa]
    real(wp), intent(in) :: density !! reference density [kg/m3]
    real(wp), intent(in) :: tau(lanes, 6) !! Kirchhoff stress [Pa]
    real(wp), intent(out) :: speed2(lanes) !! [m2/s2]
    real(wp) :: per_density
    integer :: k
    per_density = 1.0_wp/density
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      block
        real(wp) :: p, norm2, norm, x, mean, g
        p = (tau(k, 1) + tau(k, 2) + tau(k, 3))/3.0_wp
        norm2 = (tau(k, 1) - p)**2 + (tau(k, 2) - p)**2 + (tau(k, 3) - p)**2 &
          + 2.0_wp*(tau(k, 4)**2 + tau(k, 5)**2 + tau(k, 6)**2)
        norm = sqrt(norm2)
        x = sqrt(2.0_wp)*norm/mu
        mean = mu*(1.0_wp + min(x*x/12.0_wp, 0.5_wp*x))
        g = max(abs(mu - p), abs(mean - p)) + norm/sqrt(6.0_wp)
        speed2(k) = per_density*(max(lambda, 0.0_wp) &
          + max(mean + sqrt(0.5_wp*norm2 + g*g), 2.0_wp*mu - p + sqrt(2.0_wp/3.0_wp)*norm))
      end block
    end do
  end subroutine wave_bound

end module gimp_log_strain
