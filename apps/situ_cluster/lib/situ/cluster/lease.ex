defmodule Situ.Cluster.Lease do
  @moduledoc false
  # Decides which node runs a part. A lease is a key of the log that its owner writes repeatedly. Clocks are not
  # compared: the lease is free when its number has not changed for the duration of the lease, measured by the
  # observer's own clock. A reading that took longer than a lease, or that is late, gives no information about the
  # owner, so the observer starts counting again. `judge_reading/3` is pure.
  # See docs/adr/0112-a-lease-decides-which-node-runs-a-part.md.
  alias Situ.Cluster.SignedEntry
  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Entry

  defstruct [:seq, :since, :read_at, :owner, owner_down?: false, read_ms: 0]

  @typedoc """
  `seq`: the lease's number since `since` (ms); `owner_down?`: the owner's node was reported down; `read_ms`: the
  duration of the last reading.
  """
  @type t :: %__MODULE__{
          seq: non_neg_integer() | nil,
          since: integer() | nil,
          read_at: integer() | nil,
          owner: String.t() | nil,
          owner_down?: boolean(),
          read_ms: non_neg_integer()
        }

  @typedoc "One reading of the lease: its `seq` and `owner`, and the times (ms) before and after."
  @type reading :: {non_neg_integer(), String.t() | nil, integer(), integer()}

  @doc """
  Evaluates one reading of the lease: its `seq` and `owner`, and the times (ms) before and after. This observer waits
  `wait` ms longer than the lease, so that preferred nodes come first.
  """
  @spec judge_reading(t(), reading(), map()) :: {:take | :wait, t()}
  def judge_reading(%__MODULE__{} = lease, {seq, owner, started, now}, %{
        lease: ms,
        poll: poll,
        wait: wait
      }) do
    late? =
      lease.read_at != nil and (now - started > ms or started - lease.read_at > ms + 4 * poll)

    # The time of a slow reading does not count, so the count continues on a busy machine, but more slowly.
    slow = if now - started > div(ms, 4), do: now - started, else: 0
    same? = lease.seq == seq and not late?
    since = if same?, do: lease.since + slow, else: now
    owner_down? = lease.owner_down? and lease.seq == seq

    lease = %{
      lease
      | seq: seq,
        owner: owner,
        since: since,
        read_at: now,
        owner_down?: owner_down?
    }

    lease = %{lease | read_ms: now - started}

    free? =
      cond do
        seq == 0 or owner == "" -> now - since >= wait
        owner_down? -> now - since >= div(wait, 10)
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
    do: %{lease | seq: seq, owner: owner, since: now, read_at: now, owner_down?: false}

  @doc "Records that a node was reported down. This is only a hint; the fence makes the takeover safe."
  @spec note_node_down(t(), node()) :: t()
  def note_node_down(%__MODULE__{owner: owner} = lease, node),
    do: if(owner == Atom.to_string(node), do: %{lease | owner_down?: true}, else: lease)

  @doc "Reads the lease from the log."
  @spec read_lease(Log.t(), String.t()) ::
          {:ok, reading()} | {:error, Situ.Error.t()}
  def read_lease(log, key) do
    started = monotonic_ms()

    case Log.fetch_last(log, {:key, key}) do
      {:ok, entry} ->
        owner = if entry, do: Map.get(entry.head, "Node", "")
        {:ok, {if(entry, do: entry.seq, else: 0), owner, started, monotonic_ms()}}

      # An intruder or an older version has written the lease. It expires like the lease of a lost node. The next
      # owner's number is larger, so the content of this entry does not matter.
      {:error, error} ->
        if SignedEntry.refusal?(error),
          do: {:ok, {error.meta.seq, "nobody of this cluster", started, monotonic_ms()}},
          else: {:error, error}
    end
  end

  @doc "Acquires the lease, for `ms` at a time. Returns its number, which is the epoch."
  @spec acquire(Log.t(), String.t(), non_neg_integer(), pos_integer()) ::
          {:ok, pos_integer()} | {:refused, Entry.t() | nil} | {:error, Situ.Error.t()}
  def acquire(log, key, seq, ms),
    do: write_owner(log, key, seq, {Atom.to_string(node()), ms}, "take")

  @doc "Releases the lease."
  @spec release(Log.t(), String.t(), pos_integer()) :: term()
  def release(log, key, seq), do: write_owner(log, key, seq, {"", 0}, "release")

  defp write_owner(log, key, seq, {owner, ms}, verb) do
    nonce = Base.encode16(:crypto.strong_rand_bytes(6), case: :lower)
    head = %{"Node" => owner, "Ms" => Integer.to_string(ms)}
    entry = %Entry{op: "#{verb}.#{node()}.#{nonce}", head: head}
    Log.append(log, {:key, key}, seq, entry)
  end

  @doc """
  Keeps the lease: writes it every quarter of its duration. Runs in a separate process.

  When the lease is lost, or the log has not replied for three quarters of its duration, kills `publisher` immediately
  and ends this process with `{:shutdown, :lease_lost}`. A node that is cut off therefore stops before its lease ends.
  On the message `{:release, from}`, releases the lease and sends `:released`. Calls `on_change` with each number that
  it has written, and with `:free` when it releases the lease.
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
    on_change.(seq)

    await_renewal(
      %{log: log, key: key, ms: ms, publisher: publisher, on_change: on_change},
      seq,
      monotonic_ms()
    )
  end

  defp await_renewal(lease, seq, last_write) do
    receive do
      {:release, from} ->
        release(lease.log, lease.key, seq)
        lease.on_change.(:free)
        send(from, :released)

      {:EXIT, _pid, reason} when reason != :normal ->
        exit(reason)
    after
      div(lease.ms, 4) ->
        lease |> renew_lease(seq, last_write) |> handle_renewal(lease, seq, last_write)
    end
  end

  # The log may be slow to report that it is unreachable, so the write has a deadline.
  defp renew_lease(lease, seq, last_write) do
    started = monotonic_ms()
    owner = {Atom.to_string(node()), lease.ms}
    task = Task.async(fn -> write_owner(lease.log, lease.key, seq, owner, "beat") end)

    case Task.yield(task, max(renewal_deadline(lease, last_write) - started, 0)) ||
           Task.shutdown(task, :brutal_kill) do
      {:ok, result} -> {result, started}
      _ -> {:late, started}
    end
  end

  defp renewal_deadline(lease, last_write), do: last_write + div(lease.ms * 3, 4)

  defp handle_renewal({{:ok, seq}, started}, lease, _seq, _written) do
    lease.on_change.(seq)
    await_renewal(lease, seq, started)
  end

  defp handle_renewal({{:refused, _}, _started}, lease, _seq, _written), do: give_up_lease(lease)
  defp handle_renewal({:late, _started}, lease, _seq, _written), do: give_up_lease(lease)

  defp handle_renewal({{:error, _}, _started}, lease, seq, last_write),
    do:
      if(monotonic_ms() > renewal_deadline(lease, last_write),
        do: give_up_lease(lease),
        else: await_renewal(lease, seq, last_write)
      )

  defp give_up_lease(lease) do
    Process.exit(lease.publisher, :kill)
    # This is not a crash, because a node that is cut off is expected to step down.
    exit({:shutdown, :lease_lost})
  end

  defp monotonic_ms, do: System.monotonic_time(:millisecond)
end
