defmodule Situ.Cluster.Lease do
  @moduledoc false
  # Decides which node runs a part. A lease is a key of the log. Its owner writes it once, and from then on renews the
  # lease of its node (`Situ.Cluster.NodeLease`). Clocks are not compared: the lease is free when neither of the two
  # numbers has changed for the duration of the lease, measured by the observer's own clock. A reading that took longer
  # than a lease, or that is late, gives no information about the owner, so the observer starts counting again.
  # `judge_reading/3` is pure.
  # See docs/adr/0112-a-lease-decides-which-node-runs-a-part.md.
  alias Situ.Cluster.{NodeLease, NodeLeaseWatcher, SignedEntry}
  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Entry

  # The owner looks this rarely, in multiples of the lease, whether another node has taken its lease.
  @check_factor 8

  defstruct [:seq, :since, :read_at, :owner, :renewal, :looked_at, owner_down?: false, read_ms: 0]

  @typedoc """
  `seq` and `renewal`: the lease's number and the last renewal by its node, since `since` (ms); `looked_at`: when the
  lease was last read from the log; `owner_down?`: the owner's node was reported down; `read_ms`: the duration of the
  last reading.
  """
  @type t :: %__MODULE__{
          seq: non_neg_integer() | nil,
          since: integer() | nil,
          read_at: integer() | nil,
          owner: String.t() | nil,
          renewal: renewal(),
          looked_at: integer() | nil,
          owner_down?: boolean(),
          read_ms: non_neg_integer()
        }

  @typedoc """
  The lease of the owner's node, and the number of its last renewal: `nil` if its session has ended or not begun, and
  `:lost` if the owner is this node, which is on standby for the part and has therefore lost it.
  """
  @type renewal :: {NodeLease.t(), pos_integer() | nil | :lost} | nil

  @typedoc "One reading of the lease: its `seq`, `owner` and `renewal`, and the times (ms) before and after."
  @type reading :: {non_neg_integer(), String.t() | nil, renewal(), {integer(), integer()}}

  @doc """
  Evaluates one reading of the lease. This observer waits `wait` ms longer than the lease, so that preferred nodes come
  first.
  """
  @spec judge_reading(t(), reading(), map()) :: {:take | :wait, t()}
  def judge_reading(%__MODULE__{} = lease, {seq, owner, renewal, {started, now}}, %{
        lease: ms,
        poll: poll,
        wait: wait
      }) do
    late? =
      lease.read_at != nil and (now - started > ms or started - lease.read_at > ms + 4 * poll)

    # The time of a slow reading does not count, so the count continues on a busy machine, but more slowly.
    slow = if now - started > div(ms, 4), do: now - started, else: 0
    same? = lease.seq == seq and lease.renewal == renewal and not late?
    since = if same?, do: lease.since + slow, else: now
    owner_down? = lease.owner_down? and lease.seq == seq and lease.renewal in [nil, renewal]

    lease = %{
      lease
      | seq: seq,
        owner: owner,
        renewal: renewal,
        since: since,
        read_at: now,
        looked_at: now,
        owner_down?: owner_down? or match?({_own_lease, :lost}, renewal)
    }

    lease = %{lease | read_ms: now - started}

    free? =
      cond do
        seq == 0 or owner == "" -> now - since >= wait
        lease.owner_down? -> now - since >= div(wait, 10)
        true -> now - since >= ms + wait
      end

    {if(free?, do: :take, else: :wait), lease}
  end

  @doc """
  Records that the owner has reported, over the connection between the nodes, that it wrote the lease under `seq`. The
  report arrives after the write itself, so it is safe to count from now on without reading the log.
  """
  @spec note_renewal(t(), pos_integer(), String.t(), integer()) :: t()
  def note_renewal(%__MODULE__{} = lease, seq, owner, now),
    do: %{
      lease
      | seq: seq,
        owner: owner,
        renewal: nil,
        since: now,
        read_at: now,
        owner_down?: false
    }

  @doc "Records the last renewal that the owner's node has reported, without reading the log."
  @spec note_node_renewal(t(), NodeLeaseWatcher.renewal() | nil) :: t()
  def note_node_renewal(%__MODULE__{renewal: {reference, seq}} = lease, %{seq: newer, at: at})
      when newer != seq,
      do: %{lease | renewal: {reference, newer}, since: at, read_at: at, owner_down?: false}

  def note_node_renewal(lease, _renewal), do: lease

  @doc "Records that a node was reported down. This is only a hint; the fence makes the takeover safe."
  @spec note_node_down(t(), node()) :: t()
  def note_node_down(%__MODULE__{owner: owner} = lease, node),
    do: if(owner == Atom.to_string(node), do: %{lease | owner_down?: true}, else: lease)

  @doc "Reads the lease from the log. The renewal of the owner's node may be `max_age` ms old."
  @spec read_lease(Log.t(), String.t(), pos_integer()) ::
          {:ok, reading()} | {:error, Situ.Error.t()}
  def read_lease(log, key, max_age) do
    started = monotonic_ms()

    case Log.fetch_last(log, {:key, key}) do
      {:ok, nil} ->
        {:ok, {0, nil, nil, {started, monotonic_ms()}}}

      {:ok, entry} ->
        with {:ok, renewal} <- read_renewal(entry, max_age),
             do:
               {:ok,
                {entry.seq, Map.get(entry.head, "Node", ""), renewal, {started, monotonic_ms()}}}

      # An intruder or an older version has written the lease. It expires like the lease of a lost node. The next
      # owner's number is larger, so the content of this entry does not matter.
      {:error, error} ->
        if SignedEntry.refusal?(error),
          do: {:ok, {error.meta.seq, "nobody of this cluster", nil, {started, monotonic_ms()}}},
          else: {:error, error}
    end
  end

  defp read_renewal(entry, max_age) do
    reference = node_lease(entry)

    cond do
      reference == nil ->
        {:ok, nil}

      reference == NodeLease.own_lease() ->
        {:ok, {reference, :lost}}

      true ->
        with {:ok, seq} <- NodeLeaseWatcher.read_renewal(reference, max_age),
             do: {:ok, {reference, seq}}
    end
  end

  @doc "Returns the node's lease that an entry of a lease names, or `nil`, for example after a release."
  @spec node_lease(Entry.t()) :: NodeLease.t() | nil
  def node_lease(%Entry{head: %{"Renewed" => key, "Session" => session}}),
    do: %{key: key, session: session}

  def node_lease(_released), do: nil

  @doc "Acquires the lease, for `ms` at a time. Returns its number, which is the epoch."
  @spec acquire(Log.t(), String.t(), non_neg_integer(), pos_integer()) ::
          {:ok, pos_integer()} | {:refused, Entry.t() | nil} | {:error, Situ.Error.t()}
  def acquire(log, key, seq, ms),
    do: write_owner(log, key, seq, {Atom.to_string(node()), ms, NodeLease.own_lease()}, "take")

  @doc "Releases the lease."
  @spec release(Log.t(), String.t(), pos_integer()) :: term()
  def release(log, key, seq), do: write_owner(log, key, seq, {"", 0, nil}, "release")

  @doc """
  Releases the lease in the background, as soon as the log is reachable, unless another node has acquired it. A node
  that has lost a part may continue to renew the lease of the node for its other parts.
  """
  @spec release_later(Log.t(), String.t(), pos_integer()) :: {:ok, pid()}
  def release_later(log, key, seq), do: Task.start(fn -> retry_release(log, key, seq, 600) end)

  defp retry_release(log, key, seq, tries) do
    with {:error, _error} when tries > 1 <- release(log, key, seq) do
      receive do
      after
        100 -> retry_release(log, key, seq, tries - 1)
      end
    end
  end

  defp write_owner(log, key, seq, {owner, ms, reference}, verb) do
    nonce = Base.encode16(:crypto.strong_rand_bytes(6), case: :lower)
    head = %{"Node" => owner, "Ms" => Integer.to_string(ms)}

    head =
      if reference,
        do: Map.merge(head, %{"Renewed" => reference.key, "Session" => reference.session}),
        else: head

    entry = %Entry{op: "#{verb}.#{node()}.#{nonce}", head: head}
    Log.append(log, {:key, key}, seq, entry)
  end

  @doc """
  Keeps the lease while the lease of this node is renewed. Runs in a separate process.

  When another node has acquired the lease, or the log has not replied for three quarters of its duration, kills
  `publisher` immediately and ends this process with `{:shutdown, :lease_lost}`. A node that is cut off therefore stops
  before its lease ends. On the message `{:release, from}`, releases the lease and sends `:released`. Calls `on_change`
  with the number of the lease, and with `:free` when it releases the lease.
  """
  @spec keep_renewing(
          Log.t(),
          String.t(),
          pos_integer(),
          pos_integer(),
          {pid(), (pos_integer() | :free -> term())}
        ) ::
          no_return()
  def keep_renewing(log, key, seq, ms, {publisher, on_change}) do
    Process.flag(:trap_exit, true)
    :ok = NodeLease.hold(ms)
    on_change.(seq)
    lease = %{log: log, key: key, seq: seq, ms: ms, publisher: publisher, on_change: on_change}
    await_renewal(lease, monotonic_ms(), next_check(lease))
  end

  defp await_renewal(lease, acquired_at, check_at) do
    receive do
      {:release, from} ->
        release(lease.log, lease.key, lease.seq)
        lease.on_change.(:free)
        send(from, :released)

      {:EXIT, _pid, reason} when reason != :normal ->
        exit(reason)
    after
      div(lease.ms, 4) ->
        renewed_at = max(acquired_at, NodeLease.last_renewal() || acquired_at)

        cond do
          monotonic_ms() > renewed_at + div(lease.ms * 3, 4) -> give_up_lease(lease)
          monotonic_ms() < check_at -> await_renewal(lease, acquired_at, check_at)
          true -> lease |> check_owner() |> await_renewal(acquired_at, next_check(lease))
        end
    end
  end

  # Usually the new owner reports itself, or the fences refuse this node's writes. A part may write nothing.
  defp check_owner(%{seq: seq} = lease) do
    case Log.fetch_last(lease.log, {:key, lease.key}) do
      {:ok, %Entry{seq: ^seq}} -> lease
      {:ok, _another_or_none} -> give_up_lease(lease)
      {:error, error} -> if(SignedEntry.refusal?(error), do: give_up_lease(lease), else: lease)
    end
  end

  # The parts of a node look at different times.
  defp next_check(lease),
    do: monotonic_ms() + lease.ms * @check_factor + :rand.uniform(lease.ms * @check_factor)

  defp give_up_lease(lease) do
    Process.exit(lease.publisher, :kill)
    # This is not a crash, because a node that is cut off is expected to step down.
    exit({:shutdown, :lease_lost})
  end

  defp monotonic_ms, do: System.monotonic_time(:millisecond)
end
