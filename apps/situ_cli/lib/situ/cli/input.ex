defmodule Situ.CLI.Input do
  @moduledoc false
  # Reads standard input as bytes. The VM itself reads from it, so it cannot be opened as a file.

  @part 65_536

  @doc "Reads all of standard input."
  @spec read_all() :: binary()
  def read_all, do: stream_chunks() |> Enum.to_list() |> IO.iodata_to_binary()

  @doc """
  Calls `work` with a temporary file of this name that holds all of standard input, and that it may read more than once.
  Errors say "standard input" instead of its path.
  """
  @spec with_spooled_file(String.t(), (Path.t() -> result)) :: result when result: term()
  def with_spooled_file(name, work) do
    Situ.TempFolder.with_folder("input", fn folder ->
      path = Path.join(folder, name)
      {:ok, file} = :file.open(path, [:write, :raw, :binary, :exclusive])
      Enum.each(stream_chunks(), &(:ok = :file.write(file, &1)))
      :ok = :file.close(file)
      work_on(path, work)
    end)
  end

  defp work_on(path, work) do
    work.(path)
  rescue
    error in Situ.Error ->
      rename = &(&1 && String.replace(&1, path, "standard input"))

      renamed = %{
        error
        | what: rename.(error.what),
          why: rename.(error.why),
          fix: rename.(error.fix)
      }

      reraise renamed, __STACKTRACE__
  end

  # Reads bytes as Latin-1, because as UTF-8 they would have to be valid text.
  defp stream_chunks do
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
