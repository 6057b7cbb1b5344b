defmodule Situ.Dataset.Session do
  @moduledoc """
  Represents one session of a dataset: its partitions (recordings of the same time and place), metadata and tags.

      iex> session = Situ.Dataset.Session.new("p01", metadata: %{"participant" => "P01"}, tags: ["pilot"])
      iex> room = Situ.Dataset.Partition.new("Room", "/study/p01/room.0000")
      iex> {:ok, session} = Situ.Dataset.Session.add_partition(session, room)
      iex> other = Situ.Dataset.Partition.new("Room", "/elsewhere")
      iex> {:error, error} = Situ.Dataset.Session.add_partition(session, other)
      iex> error.code
      :duplicate_name

  `metadata` is any JSON object (participant, condition, notes ...), and `tags` are words for selecting sessions.
  Read a session's streams with `Situ.Dataset.OpenSession`, or in a pipeline with `Situ.Dataset.Importer`.
  """
  alias Situ.Dataset.{NameRules, Partition, Summary}
  alias Situ.Error

  @enforce_keys [:name]
  defstruct [:name, partitions: [], metadata: %{}, tags: [], extra: %{}]

  @type t :: %__MODULE__{
          name: String.t(),
          partitions: [Partition.t()],
          metadata: map(),
          tags: [String.t()],
          extra: map()
        }

  @doc "Builds an empty session. Options: `metadata:`, `tags:`."
  @spec new(String.t(), keyword()) :: t()
  def new(name, opts \\ []) when is_binary(name),
    do: %__MODULE__{name: name, metadata: opts[:metadata] || %{}, tags: opts[:tags] || []}

  @doc "Appends a partition. Errors: `:duplicate_name`, `:bad_name`."
  @spec add_partition(t(), Partition.t()) :: {:ok, t()} | {:error, Error.t()}
  def add_partition(%__MODULE__{} = session, %Partition{} = partition) do
    with :ok <- NameRules.check_valid(partition.name, "partition"),
         :ok <- NameRules.check_free(partition.name, session.partitions, session_label(session)) do
      {:ok, %{session | partitions: session.partitions ++ [partition]}}
    end
  end

  @doc "Replaces the partition that has the same name."
  @spec replace_partition(t(), Partition.t()) :: {:ok, t()} | {:error, Error.t()}
  def replace_partition(%__MODULE__{} = session, %Partition{} = partition) do
    with {:ok, _} <- fetch_partition(session, partition.name) do
      swap = &if(&1.name == partition.name, do: partition, else: &1)
      {:ok, %{session | partitions: Enum.map(session.partitions, swap)}}
    end
  end

  @doc "Removes a partition from the session; the recording is not deleted."
  @spec remove_partition(t(), String.t()) :: {:ok, t()} | {:error, Error.t()}
  def remove_partition(%__MODULE__{} = session, name) do
    with {:ok, partition} <- fetch_partition(session, name),
         do: {:ok, %{session | partitions: List.delete(session.partitions, partition)}}
  end

  @doc "Renames a partition."
  @spec rename_partition(t(), String.t(), String.t()) :: {:ok, t()} | {:error, Error.t()}
  def rename_partition(%__MODULE__{} = session, from, to) do
    with {:ok, partition} <- fetch_partition(session, from),
         :ok <- NameRules.check_valid(to, "partition"),
         :ok <-
           NameRules.check_free(
             to,
             List.delete(session.partitions, partition),
             session_label(session)
           ) do
      swap = &if(&1.name == from, do: %{&1 | name: to}, else: &1)
      {:ok, %{session | partitions: Enum.map(session.partitions, swap)}}
    end
  end

  @doc "Returns the partition with that name. Error: `:no_partition`, which suggests the nearest name."
  @spec fetch_partition(t(), String.t()) :: {:ok, Partition.t()} | {:error, Error.t()}
  def fetch_partition(%__MODULE__{} = session, name),
    do:
      NameRules.fetch_named(
        session.partitions,
        name,
        :no_partition,
        "partition",
        session_label(session)
      )

  @doc "Returns time spans, sizes and counts over all partitions; unreadable partitions are counted as `unknown`."
  @spec summary(t()) :: Summary.t()
  def summary(%__MODULE__{} = session) do
    session.partitions
    |> Enum.map(fn partition ->
      case Partition.summary(partition) do
        {:ok, summary} -> summary
        {:error, _} -> Summary.unknown_recording()
      end
    end)
    |> Summary.sum()
  end

  @doc "Lists missing and damaged recordings as `[{partition_name, error}]`."
  @spec troubles(t()) :: [{String.t(), Error.t()}]
  def troubles(%__MODULE__{} = session) do
    for partition <- session.partitions,
        {:error, error} <- [Partition.check_recording(partition)],
        do: {partition.name, error}
  end

  defp session_label(session), do: "session #{inspect(session.name)}"
end
