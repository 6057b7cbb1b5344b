defmodule Situ.Remote.Log do
  @moduledoc """
  A durable log: entries on subjects; an append names the last entry, so each happens exactly once.

  Every write names the sequence number of the entry that it follows (`0`: the subject is empty). It is refused when
  somebody else has written since: that is order, exactly-once and fencing in one. A writer whose acknowledgement was
  lost sends the same entry again; its `op`, unique to each write, tells that the entry is there already.

  Two kinds of subjects:

    * `{:stream, name}` keeps its entries, up to what `trim/3` takes away;
    * `{:key, name}` keeps the last entry only (leases, checkpoints).

  Two adapters:

  | address | adapter | for |
  |---|---|---|
  | a folder | `Situ.Remote.Log.Folder` | the processes of one machine (one local file system) |
  | `nats://host:port,host:port` | `Situ.Remote.Log.Nats` | several machines and sites: NATS JetStream, 2.9 or newer |

      iex> root = Path.join(System.tmp_dir!(), "situ-log-doc-\#{System.unique_integer([:positive])}")
      iex> {:ok, log} = Situ.Remote.Log.connect(root)
      iex> alias Situ.Remote.Log.Entry
      iex> {:ok, 1} = Situ.Remote.Log.append(log, {:stream, "a"}, 0, %Entry{op: "x.1", data: "first"})
      iex> {:refused, last} = Situ.Remote.Log.append(log, {:stream, "a"}, 0, %Entry{op: "y.1", data: "late"})
      iex> {last.seq, last.data}
      {1, "first"}
      iex> Situ.Remote.Log.append(log, {:stream, "a"}, 0, %Entry{op: "x.1", data: "first"})
      {:ok, 1}
      iex> File.rm_rf!(root) != []
      true
  """
  alias Situ.Error
  alias Situ.Remote.Log.Entry

  @enforce_keys [:adapter, :conn]
  defstruct [:adapter, :conn]

  @type t :: %__MODULE__{adapter: module(), conn: term()}
  @type subject :: {:stream | :key, String.t()}

  @typedoc """
  A subject that a log keeps: how many entries, their bytes, and when the last of them was written (ns since 1970;
  `nil` where the log does not say, as NATS for keys).
  """
  @type about :: %{
          subject: subject(),
          entries: non_neg_integer(),
          bytes: non_neg_integer() | nil,
          written: Situ.Time.t() | nil
        }

  @doc "Opens the log at an address of this adapter."
  @callback connect(address :: String.t(), keyword()) ::
              {:ok, conn :: term()} | {:error, Error.t()}

  @doc """
  Appends behind the entry `expected`; refused, with the last entry, when that is not the last one.
  `{:counts_from, seq}` when the subject is empty since all its entries were too old: the next one goes behind `seq`.
  """
  @callback append(conn :: term(), subject(), expected :: non_neg_integer(), Entry.t()) ::
              {:ok, pos_integer()}
              | {:refused, Entry.t() | nil}
              | {:counts_from, pos_integer()}
              | {:error, Error.t()}

  @doc "The last entry."
  @callback last(conn :: term(), subject()) :: {:ok, Entry.t() | nil} | {:error, Error.t()}

  @doc "Up to `most` entries, beginning with the first one that is at `from` or behind it."
  @callback read(conn :: term(), subject(), from :: pos_integer(), most :: pos_integer()) ::
              {:ok, [Entry.t()]} | {:error, Error.t()}

  @doc """
  The first entry that is at `from` or behind it, as the log's leader has it. Of a key the last two entries are kept.
  """
  @callback first(conn :: term(), subject(), from :: pos_integer()) ::
              {:ok, Entry.t() | nil} | {:error, Error.t()}

  @doc "Deletes the entries before `seq`; the last one stays."
  @callback trim(conn :: term(), subject(), seq :: pos_integer()) :: :ok | {:error, Error.t()}

  @doc "Every subject that has been written to and not deleted, in any order."
  @callback subjects(conn :: term()) :: {:ok, [about()]} | {:error, Error.t()}

  @doc "Deletes a subject with all its entries; `:ok` when there is none."
  @callback delete(conn :: term(), subject()) :: :ok | {:error, Error.t()}

  @doc "The largest `data` of one entry, bytes."
  @callback limit(conn :: term()) :: pos_integer()

  @doc "Lets go of it."
  @callback close(conn :: term()) :: :ok

  @doc "Opens the log at `address`: a folder, or `nats://...`. Options are the adapter's."
  @spec connect(String.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def connect(address, opts \\ []) when is_binary(address) do
    with {:ok, adapter} <- adapter(address),
         {:ok, conn} <- adapter.connect(address, opts),
         do: {:ok, %__MODULE__{adapter: adapter, conn: conn}}
  end

  defp adapter(address) do
    case String.split(address, "://", parts: 2) do
      ["nats", _] ->
        {:ok, __MODULE__.Nats}

      [_folder] ->
        {:ok, __MODULE__.Folder}

      [scheme, _] ->
        {:error,
         Error.new(:bad_address, "no log speaks #{scheme}://",
           fix: "give a folder, or nats://host:4222"
         )}
    end
  end

  @doc "Appends behind the entry `expected`; see `c:append/4`."
  @spec append(t(), subject(), non_neg_integer(), Entry.t()) ::
          {:ok, pos_integer()} | {:refused, Entry.t() | nil} | {:error, Error.t()}
  def append(%__MODULE__{adapter: adapter, conn: conn} = log, subject, expected, entry) do
    with {:counts_from, seq} <- adapter.append(conn, subject, expected, entry),
         do: append(log, subject, seq, entry)
  end

  @doc "The last entry, or `nil`."
  @spec last(t(), subject()) :: {:ok, Entry.t() | nil} | {:error, Error.t()}
  def last(%__MODULE__{adapter: adapter, conn: conn}, subject), do: adapter.last(conn, subject)

  @doc "Up to `most` entries from `from` on."
  @spec read(t(), subject(), pos_integer(), pos_integer()) ::
          {:ok, [Entry.t()]} | {:error, Error.t()}
  def read(%__MODULE__{adapter: adapter, conn: conn}, subject, from, most \\ 1),
    do: adapter.read(conn, subject, from, most)

  @doc "Deletes the entries before `seq`; the last one stays."
  @spec trim(t(), subject(), pos_integer()) :: :ok | {:error, Error.t()}
  def trim(%__MODULE__{adapter: adapter, conn: conn}, subject, seq),
    do: adapter.trim(conn, subject, seq)

  @doc """
  Every subject that has been written to and was not deleted, by kind and name.

      iex> root = Path.join(System.tmp_dir!(), "situ-log-doc-\#{System.unique_integer([:positive])}")
      iex> {:ok, log} = Situ.Remote.Log.connect(root)
      iex> {:ok, 1} = Situ.Remote.Log.append(log, {:stream, "a"}, 0, %Situ.Remote.Log.Entry{op: "x.1", data: "first"})
      iex> {:ok, [%{subject: {:stream, "a"}, entries: 1}]} = Situ.Remote.Log.subjects(log)
      iex> :ok = Situ.Remote.Log.delete(log, {:stream, "a"})
      iex> Situ.Remote.Log.subjects(log)
      {:ok, []}
      iex> File.rm_rf!(root) != []
      true
  """
  @spec subjects(t()) :: {:ok, [about()]} | {:error, Error.t()}
  def subjects(%__MODULE__{adapter: adapter, conn: conn}) do
    with {:ok, all} <- adapter.subjects(conn), do: {:ok, Enum.sort_by(all, & &1.subject)}
  end

  @doc """
  Deletes a subject with all that it holds, for good. Nobody must write to it any more: whoever does so begins it anew,
  and its entries count from 1.
  """
  @spec delete(t(), subject()) :: :ok | {:error, Error.t()}
  def delete(%__MODULE__{adapter: adapter, conn: conn}, subject),
    do: adapter.delete(conn, subject)

  @doc "The largest `data` of one entry, bytes."
  @spec limit(t()) :: pos_integer()
  def limit(%__MODULE__{adapter: adapter, conn: conn}), do: adapter.limit(conn)

  @doc "Lets go of it; what was appended stays."
  @spec close(t()) :: :ok
  def close(%__MODULE__{adapter: adapter, conn: conn}), do: adapter.close(conn)

  @doc """
  The entries from `from` on, up to the first for which `behind?` holds: bisected, since a header tells what an entry
  holds. Answers the sequence number of the first entry that is not wholly before what is looked for; `nil` when all
  are before.
  """
  @spec find(t(), subject(), (Entry.t() -> boolean())) ::
          {:ok, pos_integer() | nil} | {:error, Error.t()}
  def find(log, subject, enough?) do
    with {:ok, first} <- read(log, subject, 1, 1), {:ok, last} <- last(log, subject) do
      case {first, last} do
        {[], _} -> {:ok, nil}
        {_, nil} -> {:ok, nil}
        {[first], last} -> bisect(log, subject, enough?, first.seq, last.seq + 1, last.seq)
      end
    end
  end

  defp bisect(_log, _subject, _enough?, low, low, last),
    do: {:ok, if(low > last, do: nil, else: low)}

  defp bisect(log, subject, enough?, low, high, last) do
    middle = div(low + high, 2)

    case read(log, subject, middle, 1) do
      {:ok, [entry]} ->
        if enough?.(entry),
          do: bisect(log, subject, enough?, low, middle, last),
          else: bisect(log, subject, enough?, min(entry.seq + 1, high), high, last)

      {:ok, []} ->
        bisect(log, subject, enough?, low, middle, last)

      error ->
        error
    end
  end
end
