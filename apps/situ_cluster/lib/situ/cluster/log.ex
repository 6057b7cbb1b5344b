defmodule Situ.Cluster.Log do
  @moduledoc false
  # Keeps a durable log of entries, grouped by subject, in a folder or in NATS.
  #
  # Every write names the sequence number of the entry that it follows (`0` if the subject is empty). It is refused
  # if another writer has appended an entry since. This one rule provides ordering, exactly-once writes and fencing.
  # A writer whose acknowledgement was lost sends the same entry again; its `op`, unique to each write, shows that
  # the entry was already written.
  #
  # A subject `{:stream, name}` keeps all its entries, except those deleted by `trim/3`. A subject `{:key, name}`
  # keeps only the last entry (leases, checkpoints).
  # See docs/adr/0113-the-log-offers-one-conditional-append.md.
  alias Situ.Error
  alias Situ.Cluster.Log.Entry

  @enforce_keys [:adapter, :conn]
  defstruct [:adapter, :conn]

  @type t :: %__MODULE__{adapter: module(), conn: term()}
  @type subject :: {:stream | :key, String.t()}

  @typedoc """
  A subject of a log: the number of its entries, their size in bytes, and the time when the last one was written (ns
  since 1970; `nil` if the log does not record it, such as NATS for keys).
  """
  @type subject_info :: %{
          subject: subject(),
          entries: non_neg_integer(),
          bytes: non_neg_integer() | nil,
          written: Situ.Time.t() | nil
        }

  @doc "Opens the log at an address that this adapter handles."
  @callback connect(address :: String.t(), keyword()) ::
              {:ok, conn :: term()} | {:error, Error.t()}

  @doc """
  Appends after the entry `expected`. If the last entry is a different one, returns `:refused` with that entry.
  Returns `{:counts_from, seq}` if the subject is empty because all its entries have expired. The next entry follows
  `seq`.
  """
  @callback append(conn :: term(), subject(), expected :: non_neg_integer(), Entry.t()) ::
              {:ok, pos_integer()}
              | {:refused, Entry.t() | nil}
              | {:counts_from, pos_integer()}
              | {:error, Error.t()}

  @doc "Returns the last entry, or `nil`."
  @callback last(conn :: term(), subject()) :: {:ok, Entry.t() | nil} | {:error, Error.t()}

  @doc "Returns up to `max` entries, beginning with the first one whose number is at least `from`."
  @callback read(conn :: term(), subject(), from :: pos_integer(), max :: pos_integer()) ::
              {:ok, [Entry.t()]} | {:error, Error.t()}

  @doc """
  Returns the first entry whose number is at least `from`, as known to the log's leader. The last two entries of a key
  are kept.
  """
  @callback first(conn :: term(), subject(), from :: pos_integer()) ::
              {:ok, Entry.t() | nil} | {:error, Error.t()}

  @doc "Deletes the entries before `seq`; the last one stays."
  @callback trim(conn :: term(), subject(), seq :: pos_integer()) :: :ok | {:error, Error.t()}

  @doc "Lists every subject that was written to and not deleted, in any order."
  @callback subjects(conn :: term()) :: {:ok, [subject_info()]} | {:error, Error.t()}

  @doc "Deletes a subject and all its entries. Returns `:ok` if it does not exist."
  @callback delete(conn :: term(), subject()) :: :ok | {:error, Error.t()}

  @doc "Returns the largest size of an entry's `data` in bytes."
  @callback limit(conn :: term()) :: pos_integer()

  @doc "Closes the log."
  @callback close(conn :: term()) :: :ok

  @doc """
  Opens the log at `address`: a folder, or `nats://...`. The options are those of its adapter.

      iex> root = Path.join(System.tmp_dir!(), "situ-log-doc-\#{System.unique_integer([:positive])}")
      iex> {:ok, log} = Situ.Cluster.Log.connect(root)
      iex> alias Situ.Cluster.Log.Entry
      iex> {:ok, 1} = Situ.Cluster.Log.append(log, {:stream, "a"}, 0, %Entry{op: "x.1", data: "first"})
      iex> {:refused, last} = Situ.Cluster.Log.append(log, {:stream, "a"}, 0, %Entry{op: "y.1", data: "late"})
      iex> {last.seq, last.data}
      {1, "first"}
      iex> Situ.Cluster.Log.append(log, {:stream, "a"}, 0, %Entry{op: "x.1", data: "first"})
      {:ok, 1}
      iex> File.rm_rf!(root) != []
      true
  """
  @spec connect(String.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def connect(address, opts \\ []) when is_binary(address) do
    with {:ok, adapter} <- select_adapter(address),
         {:ok, conn} <- adapter.connect(address, opts),
         do: {:ok, %__MODULE__{adapter: adapter, conn: conn}}
  end

  defp select_adapter(address) do
    case String.split(address, "://", parts: 2) do
      ["nats", _] ->
        {:ok, __MODULE__.Nats}

      [_folder] ->
        {:ok, __MODULE__.Folder}

      [scheme, _] ->
        {:error,
         Error.new(:bad_address, "no log adapter supports #{scheme}://",
           fix: "give a folder, or nats://host:4222"
         )}
    end
  end

  @doc "Appends an entry after the entry `expected`; see `c:append/4`."
  @spec append(t(), subject(), non_neg_integer(), Entry.t()) ::
          {:ok, pos_integer()} | {:refused, Entry.t() | nil} | {:error, Error.t()}
  def append(%__MODULE__{adapter: adapter, conn: conn} = log, subject, expected, entry) do
    with {:counts_from, seq} <- adapter.append(conn, subject, expected, entry),
         do: append(log, subject, seq, entry)
  end

  @doc "Returns the last entry, or `nil`."
  @spec fetch_last(t(), subject()) :: {:ok, Entry.t() | nil} | {:error, Error.t()}
  def fetch_last(%__MODULE__{adapter: adapter, conn: conn}, subject),
    do: adapter.last(conn, subject)

  @doc "Returns up to `max` entries, starting at number `from`."
  @spec read(t(), subject(), pos_integer(), pos_integer()) ::
          {:ok, [Entry.t()]} | {:error, Error.t()}
  def read(%__MODULE__{adapter: adapter, conn: conn}, subject, from, max \\ 1),
    do: adapter.read(conn, subject, from, max)

  @doc "Deletes the entries before `seq`; the last one stays."
  @spec trim(t(), subject(), pos_integer()) :: :ok | {:error, Error.t()}
  def trim(%__MODULE__{adapter: adapter, conn: conn}, subject, seq),
    do: adapter.trim(conn, subject, seq)

  @doc """
  Lists every subject that was written to and not deleted, by kind and name.

      iex> root = Path.join(System.tmp_dir!(), "situ-log-doc-\#{System.unique_integer([:positive])}")
      iex> {:ok, log} = Situ.Cluster.Log.connect(root)
      iex> {:ok, 1} = Situ.Cluster.Log.append(log, {:stream, "a"}, 0, %Situ.Cluster.Log.Entry{op: "x.1", data: "first"})
      iex> {:ok, [%{subject: {:stream, "a"}, entries: 1}]} = Situ.Cluster.Log.list_subjects(log)
      iex> :ok = Situ.Cluster.Log.delete(log, {:stream, "a"})
      iex> Situ.Cluster.Log.list_subjects(log)
      {:ok, []}
      iex> File.rm_rf!(root) != []
      true
  """
  @spec list_subjects(t()) :: {:ok, [subject_info()]} | {:error, Error.t()}
  def list_subjects(%__MODULE__{adapter: adapter, conn: conn}) do
    with {:ok, all} <- adapter.subjects(conn), do: {:ok, Enum.sort_by(all, & &1.subject)}
  end

  @doc """
  Deletes a subject and all its entries permanently. No process should still write to it: a later append creates the
  subject again, and its entries count from 1.
  """
  @spec delete(t(), subject()) :: :ok | {:error, Error.t()}
  def delete(%__MODULE__{adapter: adapter, conn: conn}, subject),
    do: adapter.delete(conn, subject)

  @doc "Returns the largest size of an entry's `data` in bytes."
  @spec max_data_size(t()) :: pos_integer()
  def max_data_size(%__MODULE__{adapter: adapter, conn: conn}), do: adapter.limit(conn)

  @doc "Closes the log. Appended entries are kept."
  @spec close(t()) :: :ok
  def close(%__MODULE__{adapter: adapter, conn: conn}), do: adapter.close(conn)

  @doc """
  Finds the first entry for which `reached?` returns true, by bisection: once true, it must stay true for later entries.
  Returns the sequence number of that entry, or `nil` if there is none.
  """
  @spec find_position(t(), subject(), (Entry.t() -> boolean())) ::
          {:ok, pos_integer() | nil} | {:error, Error.t()}
  def find_position(log, subject, reached?) do
    with {:ok, first} <- read(log, subject, 1, 1), {:ok, last} <- fetch_last(log, subject) do
      case {first, last} do
        {[], _} -> {:ok, nil}
        {_, nil} -> {:ok, nil}
        {[first], last} -> bisect_range(log, subject, reached?, first.seq, last.seq + 1, last.seq)
      end
    end
  end

  defp bisect_range(_log, _subject, _enough?, from, from, last),
    do: {:ok, if(from > last, do: nil, else: from)}

  defp bisect_range(log, subject, reached?, from, to, last) do
    middle = div(from + to, 2)

    case read(log, subject, middle, 1) do
      {:ok, [entry]} ->
        if reached?.(entry),
          do: bisect_range(log, subject, reached?, from, middle, last),
          else: bisect_range(log, subject, reached?, min(entry.seq + 1, to), to, last)

      {:ok, []} ->
        bisect_range(log, subject, reached?, from, middle, last)

      error ->
        error
    end
  end
end
