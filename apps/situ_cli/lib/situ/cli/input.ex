defmodule Situ.CLI.Input do
  @moduledoc false
  # Standard input as bytes. The VM reads it by itself, so it cannot be opened as a file.

  @part 65_536

  @doc "All of it."
  @spec read() :: binary()
  def read, do: parts() |> Enum.to_list() |> IO.iodata_to_binary()

  @doc "In a file of its own for as long as `work` takes, that may read it twice."
  @spec spooled((Path.t() -> result)) :: result when result: term()
  def spooled(work) do
    Situ.Scratch.with_folder("input", fn folder ->
      path = Path.join(folder, "input")
      {:ok, file} = :file.open(path, [:write, :raw, :binary, :exclusive])
      Enum.each(parts(), &(:ok = :file.write(file, &1)))
      :ok = :file.close(file)
      work.(path)
    end)
  end

  # Bytes, whatever text they are: as text it would have to be UTF-8.
  defp parts do
    Stream.resource(
      fn ->
        before = :io.getopts(:standard_io)
        _ = :io.setopts(:standard_io, encoding: :latin1)
        if is_list(before), do: before[:encoding]
      end,
      fn before ->
        case IO.binread(:stdio, @part) do
          bytes when is_binary(bytes) -> {[bytes], before}
          _end_or_error -> {:halt, before}
        end
      end,
      fn before -> :io.setopts(:standard_io, encoding: before || :unicode) end
    )
  end
end
