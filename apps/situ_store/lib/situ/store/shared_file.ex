defmodule Situ.Store.SharedFile do
  @moduledoc false
  # Files in memory through which the VM exchanges large values with a program that maps them too
  # (`native/situ_store/src/shared.rs`). Each file has one writer: the VM, or the program. A value that the program has
  # written becomes a binary without a copy. Its slot is in use until the VM has collected the binary.
  # See docs/adr/0177-results-of-workers-are-read-in-place.md.
  alias Situ.Store.Native

  # Copying fewer bytes takes less than 100 us.
  @quick_bytes 524_288

  @opaque writer :: reference()
  @opaque reader :: reference()
  @typedoc "Where a value is: the number of its slot, its offset and its length in bytes."
  @type place :: {slot :: non_neg_integer(), offset :: non_neg_integer(), length :: pos_integer()}

  @doc "Creates a file that the VM writes, for at most `limit` bytes. `path` must not exist."
  @spec create_writer(Path.t(), pos_integer()) :: {:ok, writer()} | {:error, term()}
  def create_writer(path, limit), do: Native.shared_writer(path, limit)

  @doc "Creates a file that the program writes, for at most `limit` bytes. `path` must not exist."
  @spec create_reader(Path.t(), pos_integer()) :: {:ok, reader()} | {:error, term()}
  def create_reader(path, limit), do: Native.shared_reader(path, limit)

  @doc "Allocates memory for the first `size` bytes."
  @spec reserve(writer(), non_neg_integer()) :: :ok | {:error, term()}
  def reserve(writer, size), do: Native.shared_reserve(writer, size)

  @doc "Copies a value of `length` bytes to `offset`. The memory must have been reserved."
  @spec write(writer(), non_neg_integer(), iodata(), non_neg_integer()) :: :ok | {:error, term()}
  def write(writer, offset, value, length) do
    parts = :erlang.iolist_to_iovec(value)

    if length <= @quick_bytes,
      do: Native.shared_write_quick(writer, offset, parts),
      else: Native.shared_write(writer, offset, parts)
  end

  @doc """
  Returns a value that the program has written. `:shared` is a binary that refers to the memory, and its slot is in use
  until `take_released/1` returns it. If more than half of the memory is in use in this way, the value is `:copied`,
  and its slot is free.
  """
  @spec read(reader(), place()) :: {:shared | :copied, binary()} | {:error, term()}
  def read(reader, {slot, offset, length}) do
    case Native.shared_read(reader, slot, offset, length) do
      {:ok, bytes} -> {:shared, bytes}
      :slow -> copy(reader, offset, length)
      {:error, reason} -> {:error, reason}
    end
  end

  defp copy(reader, offset, length) do
    with {:ok, bytes} <- Native.shared_copy(reader, offset, length), do: {:copied, bytes}
  end

  @doc "Returns the slots whose binaries were collected since the last call."
  @spec take_released(reader()) :: [non_neg_integer()]
  def take_released(reader), do: Native.shared_released(reader)
end
