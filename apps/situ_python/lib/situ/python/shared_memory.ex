defmodule Situ.Python.SharedMemory do
  @moduledoc false
  # The memory that a component shares with its Python worker, in `/dev/shm` where the system has it: two files of
  # slots, one for each direction, and a journal of the last results, which outlive a crash of Python. Slots
  # are only added, so a file that Python has mapped never shrinks. The folder is removed as soon as both sides have
  # opened the files, so nothing remains when both have ended.
  # See docs/adr/0170-python-components-run-in-workers.md.
  alias Situ.Python.Protocol
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
          input: :file.io_device(),
          output: :file.io_device(),
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
  @spec create_files(Path.t(), pos_integer()) :: {:ok, t()} | {:error, :file.posix()}
  def create_files(folder, limit) do
    with {:ok, input} <- create_file(folder, "in"),
         {:ok, output} <- create_file(folder, "out"),
         {:ok, journal} <- create_file(folder, "journal"),
         :ok <- :file.pwrite(journal, @journal_bytes - 1, <<0>>),
         do: {:ok, %__MODULE__{input: input, output: output, journal: journal, limit: limit}}
  end

  defp create_file(folder, name),
    do: :file.open(Path.join(folder, name), [:raw, :binary, :read, :write, :exclusive])

  @doc "Writes a value of `length` bytes into a slot. Returns `:full` if the memory is in use."
  @spec write_value(t(), iodata(), pos_integer()) :: {:ok, Protocol.slot(), t()} | :full
  def write_value(memory, value, length) do
    with {:ok, slot, memory} <- take_slot(memory, length),
         :ok <- :file.pwrite(memory.input, slot.offset, value) do
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

  # Writing the last byte makes the file as long as its slots, as Python checks before it maps one.
  defp add_slot(%{size: size, limit: limit}, capacity) when size + capacity > limit, do: :full

  defp add_slot(%{size: size} = memory, capacity) do
    with :ok <- :file.pwrite(memory.input, size + capacity - 1, <<0>>) do
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

  @doc "Reads a value that Python has written."
  @spec read_value(t(), Protocol.slot()) :: {:ok, binary()} | {:error, String.t()}
  def read_value(memory, %{offset: offset, capacity: capacity, length: length})
      when length > 0 and length <= capacity and offset + capacity <= memory.limit do
    case :file.pread(memory.output, offset, length) do
      {:ok, bytes} when byte_size(bytes) == length -> {:ok, bytes}
      _ -> {:error, "the shared memory has no #{length} bytes at #{offset}"}
    end
  end

  def read_value(_memory, slot),
    do: {:error, "#{slot.length} bytes at #{slot.offset} are outside of the shared memory"}

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

  @doc "Closes the files."
  @spec close_files(t()) :: :ok
  def close_files(memory) do
    _ = :file.close(memory.input)
    _ = :file.close(memory.output)
    _ = :file.close(memory.journal)
    :ok
  end
end
