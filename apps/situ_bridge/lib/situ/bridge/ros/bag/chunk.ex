defmodule Situ.Bridge.Ros.Bag.Chunk do
  @moduledoc false
  # Reads and unpacks a chunk of a bag. If the file is cut short, the last chunk is read up to the end of the file.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Bridge.Native
  alias Situ.Bridge.Ros.Bag.Record

  @max_bytes 1_073_741_824

  @spec read(:file.fd(), non_neg_integer(), non_neg_integer()) ::
          {:ok, binary()} | {:error, String.t()}
  def read(file, at, size) do
    with {:ok, <<h::little-32>>} <- :file.pread(file, at, 4),
         {:ok, <<header::binary-pinned_size(h), d::little-32>>} <-
           :file.pread(file, at + 4, h + 4),
         {:ok, fields} <- Record.parse_fields(header),
         {:ok, data} <- :file.pread(file, at + 8 + h, min(d, max(size - at - 8 - h, 0))) do
      unpack_chunk(fields["compression"], data, Record.get_u32(fields, "size") || 0)
    else
      _ -> {:error, "its header or its data cannot be read"}
    end
  end

  defp unpack_chunk("none", data, _size), do: {:ok, data}

  defp unpack_chunk("lz4", data, size) when size <= @max_bytes,
    do: Native.unpack("lz4", data, size)

  defp unpack_chunk(other, _data, _size),
    do:
      {:error,
       "its compression #{inspect(other)} is not supported (unpack the bag with `rosbag decompress`)"}
end
