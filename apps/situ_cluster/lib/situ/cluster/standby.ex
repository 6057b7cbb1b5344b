defmodule Situ.Cluster.Standby do
  @moduledoc false
  # Holds the state of a node that waits for a part it does not run: the last known lease, the time of the next look
  # at it, and the number of nodes that may take the part first. Each node reports the renewals of its lease to the
  # other nodes (`Situ.Cluster.NodeLease`). A node therefore looks at the log only when two renewals are missing, or
  # when it has no connection to the owner.
  alias Situ.Cluster.{Backoff, Lease, NodeLeaseWatcher}

  # A drained node waits as if this many nodes were preferred to it.
  @demotion_weight 10

  # A report of an acquired or released lease may be lost, so the log is read this rarely, in multiples of the lease.
  @look_factor 16

  @enforce_keys [:ms]
  defstruct [:ms, :timer, :previous, lease: %Lease{}, backoff: %Backoff{}, demotion: 0, wait: 0]

  @typedoc """
  `ms`: the duration of the lease; `demotion`: the demotion level of the node; `previous`: the monitor of the process
  for whose lifetime that level applies, and the level before that; `wait`: how long preferred nodes come first (ms).
  """
  @type t :: %__MODULE__{
          ms: pos_integer(),
          timer: reference() | nil,
          previous: {reference(), non_neg_integer()} | nil,
          lease: Lease.t(),
          backoff: Backoff.t(),
          demotion: non_neg_integer(),
          wait: non_neg_integer()
        }

  @spec new(Situ.Time.duration()) :: t()
  def new(lease_ns), do: %__MODULE__{ms: max(div(lease_ns, 1_000_000), 20)}

  @doc "Judges one look at the lease; `rank` nodes are preferred to this one."
  @spec judge_reading(t(), Lease.reading(), non_neg_integer()) :: {:take | :wait, t()}
  def judge_reading(%__MODULE__{ms: ms} = standby, reading, rank) do
    # A drained node lets the others go first for some seconds, but takes a part that no other node takes.
    precedence = rank + @demotion_weight * standby.demotion
    wait = precedence * div(ms, 2) + Backoff.wait_ms(standby.backoff, monotonic_ms(), ms)

    {decision, lease} =
      Lease.judge_reading(standby.lease, reading, %{
        lease: ms,
        poll: poll_interval(ms),
        wait: wait
      })

    {decision, %{standby | lease: lease, wait: wait}}
  end

  @doc "Records that the owner has written its lease under this number."
  @spec note_renewal(t(), pos_integer(), String.t()) :: t()
  def note_renewal(%__MODULE__{ms: ms} = standby, seq, owner),
    do:
      schedule_check(
        %{standby | lease: Lease.note_renewal(standby.lease, seq, owner, monotonic_ms())},
        div(ms, 2)
      )

  @doc "Records that the owner has released the lease, so that this node looks at the log immediately."
  @spec note_release(t()) :: t()
  def note_release(%__MODULE__{lease: lease} = standby),
    do: schedule_check(%{standby | lease: %{lease | renewal: nil}}, 0)

  @doc """
  Returns whether the owner's node has recently reported a renewal, so that this node need not look at the log, and
  takes note of it.
  """
  @spec note_node_renewal(t()) :: {boolean(), t()}
  def note_node_renewal(%__MODULE__{ms: ms, lease: %{renewal: {reference, _}}} = standby) do
    renewal = NodeLeaseWatcher.known_renewal(reference)
    lease = Lease.note_node_renewal(standby.lease, renewal)
    now = monotonic_ms()

    recent? =
      renewal != nil and now - renewal.at <= div(ms, 2) and not lease.owner_down? and
        now - lease.looked_at < look_interval(ms)

    {recent?, %{standby | lease: lease}}
  end

  def note_node_renewal(standby), do: {false, standby}

  # The runners of a node look at different times.
  defp look_interval(ms),
    do: @look_factor * ms + rem(:erlang.phash2(self()), @look_factor * ms)

  @doc "Records that a node was reported down."
  @spec note_node_down(t(), node()) :: t()
  def note_node_down(%__MODULE__{} = standby, node) do
    {_recent?, standby} = note_node_renewal(standby)
    standby = %{standby | lease: Lease.note_node_down(standby.lease, node)}
    if standby.lease.owner_down?, do: schedule_check(standby, 0), else: standby
  end

  @doc "Starts waiting again after this node has lost the part."
  @spec resume_after_loss(t()) :: t()
  def resume_after_loss(%__MODULE__{ms: ms} = standby),
    do: restart_wait(%{standby | backoff: Backoff.add_loss(standby.backoff, monotonic_ms(), ms)})

  @doc "Starts waiting again after this node has released the part."
  @spec restart_wait(t()) :: t()
  def restart_wait(%__MODULE__{} = standby), do: schedule_next_check(%{standby | lease: %Lease{}})

  @doc """
  Sends this process `:check` after a delay, which is longer if the log responds slowly, or if other nodes may take a
  free lease first.
  """
  @spec schedule_next_check(t()) :: t()
  def schedule_next_check(%__MODULE__{ms: ms, lease: lease} = standby) do
    delay = max(4 * lease.read_ms, wait_left(standby))
    schedule_check(standby, max(poll_interval(ms), min(delay, ms)))
  end

  @doc "Sends this process `:check` after half a lease, since the owner's node is alive."
  @spec schedule_late_check(t()) :: t()
  def schedule_late_check(%__MODULE__{ms: ms} = standby), do: schedule_check(standby, div(ms, 2))

  defp wait_left(%{lease: %{seq: seq, owner: owner, since: since}, wait: wait})
       when since != nil and (seq == 0 or owner == ""),
       do: since + wait - monotonic_ms()

  defp wait_left(_standby), do: 0

  @doc "Returns how old (ms) the known renewal of the owner's node may be when the lease is read."
  @spec max_age(t()) :: pos_integer()
  def max_age(%__MODULE__{ms: ms}), do: poll_interval(ms)

  @doc "Sends this process `:check` in `ms`, and cancels an earlier timer."
  @spec schedule_check(t(), non_neg_integer()) :: t()
  def schedule_check(%__MODULE__{timer: timer} = standby, ms) do
    _ = timer && Process.cancel_timer(timer)
    %{standby | timer: Process.send_after(self(), :check, ms)}
  end

  @doc "Sets the demotion level; with a process, only for the lifetime of that process."
  @spec set_demotion(t(), non_neg_integer(), pid() | nil) :: t()
  def set_demotion(%__MODULE__{previous: {ref, before}} = standby, demotion, mover) do
    Process.demonitor(ref, [:flush])
    set_demotion(%{standby | previous: nil, demotion: before}, demotion, mover)
  end

  # A node to which the part is moved does not wait because of earlier losses.
  def set_demotion(standby, 0, nil), do: %{standby | demotion: 0, backoff: %Backoff{}}
  def set_demotion(standby, demotion, nil), do: %{standby | demotion: demotion}

  def set_demotion(standby, demotion, mover),
    do: %{standby | previous: {Process.monitor(mover), standby.demotion}, demotion: demotion}

  @doc "Restores the previous demotion level if `ref` is the monitor of the process for which it was set."
  @spec restore_demotion(t(), reference()) :: t()
  def restore_demotion(%__MODULE__{previous: {ref, before}} = standby, ref),
    do: %{standby | previous: nil, demotion: before}

  def restore_demotion(standby, _ref), do: standby

  defp poll_interval(ms), do: max(div(ms, 10), 5)
  defp monotonic_ms, do: System.monotonic_time(:millisecond)
end
