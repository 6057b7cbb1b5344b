defmodule Situ.Cluster.SealedLog do
  @moduledoc false
  # Wraps a log for one run of a deployment: seals every entry that is written, and verifies every entry that is read
  # (`Situ.Cluster.SignedEntry`). All streams, leases, state entries and checkpoints of the cluster use it. A refused
  # entry is an error (`:forged_entry`, `:unsealed_entry`) and never data.
  # See docs/adr/0119-log-entries-are-sealed-with-their-position.md.
  @behaviour Situ.Cluster.Log

  alias Situ.Cluster.SignedEntry
  alias Situ.Error
  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Entry

  @enforce_keys [:log, :run]
  defstruct [:log, :run]

  @type t :: %__MODULE__{log: Log.t(), run: String.t()}

  @doc "Wraps a log for one run."
  @spec new(Log.t(), String.t()) :: Log.t()
  def new(%Log{} = log, run),
    do: %Log{adapter: __MODULE__, conn: %__MODULE__{log: log, run: run}}

  @impl true
  def connect(_address, _opts),
    do: {:error, Error.new(:bad_address, "a sealed log has no address: it wraps another log")}

  @impl true
  def append(%__MODULE__{log: log, run: run} = conn, subject, expected, %Entry{} = entry) do
    sealed = SignedEntry.seal_entry(entry, run, subject, expected)

    case log.adapter.append(log.conn, subject, expected, sealed) do
      {:refused, %Entry{} = last} ->
        with {:ok, last} <- check_entry(conn, subject, last), do: {:refused, last}

      # The stream is empty, but its numbers continue, and the seal includes the number.
      {:counts_from, seq} ->
        append(conn, subject, seq, entry)

      answer ->
        answer
    end
  end

  @impl true
  def last(%__MODULE__{log: log} = conn, subject) do
    with {:ok, %Entry{} = entry} <- Log.fetch_last(log, subject),
         do: check_entry(conn, subject, entry)
  end

  @impl true
  def read(%__MODULE__{log: log} = conn, subject, from, most) do
    with {:ok, entries} <- Log.read(log, subject, from, most),
         do: check_all(conn, subject, entries, [])
  end

  defp check_all(_conn, _subject, [], verified), do: {:ok, Enum.reverse(verified)}

  defp check_all(conn, subject, [entry | rest], verified) do
    with {:ok, entry} <- check_entry(conn, subject, entry),
         do: check_all(conn, subject, rest, [entry | verified])
  end

  defp check_entry(conn, subject, entry) do
    case SignedEntry.verify_entry(entry, conn.run, subject) do
      {:behind, follows, entry} -> check_previous(conn.log, subject, follows, entry)
      answer -> answer
    end
  end

  # An intruder who repeats the entry of a lease only delays a takeover: a lease contains no data, its number is the
  # epoch, and numbers only increase. Leases are read too often for a second read each time.
  defp check_previous(_log, {:key, "lease." <> _}, _follows, entry), do: {:ok, entry}
  defp check_previous(_log, {:key, "node_lease." <> _}, _follows, entry), do: {:ok, entry}

  # Logs keep the last two entries of a key, and an entry names the one before it.
  defp check_previous(log, subject, follows, entry) do
    case log.adapter.first(log.conn, subject, max(follows, 1)) do
      {:ok, %Entry{seq: ^follows}} -> {:ok, entry}
      {:ok, %Entry{seq: seq}} when follows == 0 and seq == entry.seq -> {:ok, entry}
      {:ok, _another} -> check_last(log, subject, entry)
      {:error, error} -> {:error, error}
    end
  end

  # Two later writes delete the previous entry, and then this entry is no longer the last one.
  defp check_last(log, subject, entry) do
    case Log.fetch_last(log, subject) do
      {:ok, %Entry{seq: seq}} when seq != entry.seq ->
        {:error,
         Error.new(:log_away, "the key #{elem(subject, 1)} is being written", fix: "read it again")}

      {:ok, _same} ->
        {:error, SignedEntry.moved_error(entry, subject)}

      {:error, error} ->
        {:error, error}
    end
  end

  @impl true
  def first(%__MODULE__{log: log} = conn, subject, from) do
    with {:ok, %Entry{} = entry} <- log.adapter.first(log.conn, subject, from),
         do: check_entry(conn, subject, entry)
  end

  @impl true
  def trim(%__MODULE__{log: log}, subject, seq), do: Log.trim(log, subject, seq)
  @impl true
  def subjects(%__MODULE__{log: log}), do: Log.list_subjects(log)
  @impl true
  def delete(%__MODULE__{log: log}, subject), do: Log.delete(log, subject)
  @impl true
  def limit(%__MODULE__{log: log}), do: Log.max_data_size(log)
  @impl true
  def close(%__MODULE__{log: log}), do: Log.close(log)
end
