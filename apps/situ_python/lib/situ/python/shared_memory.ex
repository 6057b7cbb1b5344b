defmodule Situ.Python.SharedMemory do
  @moduledoc false
  # The memory that a component shares with its Python worker, in `/dev/shm` where the system has it: two files of
  # slots, one for each direction, and a journal of the last results, which outlive a crash of Python. Slots
  # are only added, so a file that Python has mapped never shrinks. The folder is removed as soon as both sides have
  # opened the files, so nothing remains when both have ended.
  # See docs/adr/0170-python-components-run-in-workers.md.
  alias Situ.Python.Protocol
  alias Situ.Store.SharedFile
  alias Situ.TempFolder

  @page 4096
  # A slot is at most this many times larger than its value, so that small values do not take the slots of large ones.
  @waste 4

  @journal_bytes 1_048_576

  @enforce_keys [:input, :output, :journal, :limit]
  defstruct [
    :input,
    :output,
    :journal,
    :limit,
    size: 0,
    free: [],
    capacities: %{},
    used: MapSet.new()
  ]

  @type t :: %__MODULE__{
          input: SharedFile.writer(),
          output: SharedFile.reader(),
          journal: :file.io_device(),
          limit: pos_integer(),
          size: non_neg_integer(),
          free: [Protocol.slot()],
          capacities: %{non_neg_integer() => Protocol.slot()},
          used: MapSet.t(non_neg_integer())
        }

  @doc "Creates a folder for the files of a component: in `/dev/shm`, or in the system's temporary folder."
  @spec create_folder() :: {:ok, Path.t()} | {:error, Situ.Error.t()}
  def create_folder do
    if File.dir?("/dev/shm"),
      do: TempFolder.create_folder("python", "/dev/shm"),
      else: TempFolder.create_folder("python")
  end

  @doc "Creates the files in `folder`, for at most `limit` bytes in each direction. Only this process can use them."
  @spec create_files(Path.t(), pos_integer()) :: {:ok, t()} | {:error, term()}
  def create_files(folder, limit) do
    with {:ok, input} <- SharedFile.create_writer(Path.join(folder, "in"), limit),
         {:ok, output} <- SharedFile.create_reader(Path.join(folder, "out"), limit),
         {:ok, journal} <- create_journal(folder),
         do: {:ok, %__MODULE__{input: input, output: output, journal: journal, limit: limit}}
  end

  defp create_journal(folder) do
    path = Path.join(folder, "journal")

    with {:ok, journal} <- :file.open(path, [:raw, :binary, :read, :write, :exclusive]),
         :ok <- :file.pwrite(journal, @journal_bytes - 1, <<0>>),
         do: {:ok, journal}
  end

  @doc "Writes a value of `length` bytes into a slot. Returns `:full` if the memory is in use."
  @spec write_value(t(), iodata(), pos_integer()) :: {:ok, Protocol.slot(), t()} | :full
  def write_value(memory, value, length) do
    with {:ok, slot, memory} <- take_slot(memory, length),
         :ok <- SharedFile.write(memory.input, slot.offset, value, length) do
      {:ok, %{slot | length: length}, memory}
    else
      _ -> :full
    end
  end

  defp take_slot(memory, length) do
    case Enum.split_while(memory.free, &(not fitting_slot?(&1, length))) do
      {before, [slot | rest]} -> {:ok, slot, mark_used(%{memory | free: before ++ rest}, slot)}
      {_all, []} -> add_slot(memory, div(length + @page - 1, @page) * @page)
    end
  end

  defp fitting_slot?(slot, length),
    do: slot.capacity >= length and slot.capacity <= @waste * length

  defp mark_used(memory, slot), do: %{memory | used: MapSet.put(memory.used, slot.number)}

  defp add_slot(%{size: size, limit: limit}, capacity) when size + capacity > limit, do: :full

  defp add_slot(%{size: size} = memory, capacity) do
    with :ok <- SharedFile.reserve(memory.input, size + capacity) do
      number = map_size(memory.capacities)
      slot = %{number: number, offset: size, capacity: capacity, length: capacity}
      slots = Map.put(memory.capacities, number, slot)
      {:ok, slot, mark_used(%{memory | size: size + capacity, capacities: slots}, slot)}
    end
  end

  @doc "Marks slots as free that Python no longer uses. Returns `:error` for slots that are not in use."
  @spec free_slots(t(), [non_neg_integer()]) :: {:ok, t()} | :error
  def free_slots(memory, numbers) do
    if Enum.all?(numbers, &(&1 in memory.used)) and numbers == Enum.uniq(numbers) do
      free = Enum.map(numbers, &Map.fetch!(memory.capacities, &1)) ++ memory.free
      {:ok, %{memory | free: free, used: MapSet.difference(memory.used, MapSet.new(numbers))}}
    else
      :error
    end
  end

  @doc """
  Returns a value that Python has written. The slot of a `:shared` value is in use until `take_released/1` returns it.
  That of a `:copied` value is free.
  """
  @spec read_value(t(), Protocol.slot()) :: {:shared | :copied, binary()} | {:error, String.t()}
  def read_value(memory, %{offset: offset, capacity: capacity, length: length} = slot)
      when length > 0 and length <= capacity do
    with {:error, _reason} <- SharedFile.read(memory.output, {slot.number, offset, length}),
         do: {:error, "the shared memory has no #{length} bytes at #{offset}"}
  end

  def read_value(_memory, slot),
    do: {:error, "a slot of #{slot.capacity} bytes cannot contain #{slot.length} bytes"}

  @doc "Returns the slots of shared values that were collected since the last call."
  @spec take_released(t()) :: [non_neg_integer()]
  def take_released(memory), do: SharedFile.take_released(memory.output)

  @doc "Returns the results in the journal, and the number of results before them."
  @spec read_journal(t()) :: {non_neg_integer(), binary()}
  def read_journal(memory) do
    with {:ok, <<sent::little-64, length::little-64>>} <- :file.pread(memory.journal, 0, 16),
         true <- length in 1..@journal_bytes,
         {:ok, bytes} <- :file.pread(memory.journal, 16, length) do
      {sent, bytes}
    else
      _ -> {0, <<>>}
    end
  end

  @doc "Closes the journal. The memory of the slots is free when no value refers to it any more."
  @spec close_files(t()) :: :ok
  def close_files(memory) do
    _ = :file.close(memory.journal)
    :ok
  end
end
