defmodule Situ.Cluster.NodeLeaseWatcher do
  @moduledoc false
  # Knows the last renewal of every node's lease, for all runners of this node. The owner reports each renewal over the
  # connection between the nodes. If the reports stop, this process reads the lease in the log, once for all runners
  # that ask within a tenth of their lease.
  use GenServer

  alias Situ.Cluster.{Log, NodeLease, SealedLog, SignedEntry}

  @table __MODULE__

  @typedoc "A node's `session`, and the number `seq` of its last renewal, seen `at` this time (monotonic ms)."
  @type renewal :: %{session: String.t() | nil, seq: non_neg_integer(), at: integer()}

  @spec start_link(Log.t()) :: GenServer.on_start()
  def start_link(log), do: GenServer.start_link(__MODULE__, log, name: __MODULE__)

  @doc "Creates the table. The calling process owns it."
  @spec create_table() :: :ok
  def create_table do
    :ets.new(@table, [:named_table, :public, read_concurrency: true])
    :ok
  end

  @doc "Records that the owner of a lease has reported its renewal."
  @spec note_renewal(NodeLease.t(), pos_integer()) :: :ok
  def note_renewal(%{key: key, session: session}, seq), do: put_renewal(key, session, seq)

  @doc "Returns the last known renewal of a lease, or `nil`. Does not read the log."
  @spec known_renewal(NodeLease.t()) :: renewal() | nil
  def known_renewal(%{key: key, session: session}) do
    case lookup_renewal(key) do
      %{session: ^session} = renewal -> renewal
      _unknown_or_restarted -> nil
    end
  end

  @doc """
  Returns the number of the last renewal, at most `max_age` ms old, or `nil` if the node has another session since.
  """
  @spec read_renewal(NodeLease.t(), pos_integer()) ::
          {:ok, pos_integer() | nil} | {:error, Situ.Error.t()}
  def read_renewal(%{key: key, session: session}, max_age) do
    renewal = lookup_renewal(key)

    result =
      if within_age?(renewal, max_age),
        do: {:ok, renewal},
        else: GenServer.call(__MODULE__, {:read, key, max_age}, :infinity)

    with {:ok, renewal} <- result,
         do: {:ok, if(renewal.session == session, do: renewal.seq)}
  end

  @impl true
  def init(log), do: {:ok, SealedLog.new(log, "")}

  @impl true
  def handle_call({:read, key, max_age}, _from, log) do
    # The process may have read the lease for another runner while this call was waiting.
    renewal = lookup_renewal(key)

    if within_age?(renewal, max_age),
      do: {:reply, {:ok, renewal}, log},
      else: {:reply, fetch_renewal(log, key), log}
  end

  defp fetch_renewal(log, key) do
    case Log.fetch_last(log, {:key, key}) do
      {:ok, nil} ->
        {:ok, %{session: nil, seq: 0, at: monotonic_ms()}}

      {:ok, entry} ->
        put_renewal(key, entry.head["Session"], entry.seq)
        {:ok, lookup_renewal(key)}

      # An intruder has written the lease. It expires like the lease of a lost node.
      {:error, error} ->
        if SignedEntry.refusal?(error),
          do: {:ok, %{session: nil, seq: error.meta.seq, at: monotonic_ms()}},
          else: {:error, error}
    end
  end

  defp lookup_renewal(key) do
    case :ets.lookup(@table, key) do
      [{_, session, seq, at}] -> %{session: session, seq: seq, at: at}
      [] -> nil
    end
  end

  # A report may arrive after a reading that is newer. Its number then only shows again that the node is alive. Numbers
  # are not compared, because they begin again if the log was deleted.
  defp put_renewal(key, session, seq) do
    :ets.insert(@table, {key, session, seq, monotonic_ms()})
    :ok
  end

  defp within_age?(nil, _max_age), do: false
  defp within_age?(renewal, max_age), do: monotonic_ms() - renewal.at <= max_age
  defp monotonic_ms, do: System.monotonic_time(:millisecond)
end
