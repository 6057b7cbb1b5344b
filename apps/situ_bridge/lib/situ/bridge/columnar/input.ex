defmodule Situ.Bridge.Columnar.Input do
  @moduledoc false
  # Reads the bytes of a file at any offset, and streams the rows that a reader decodes from them. A reader throws
  # `{kind, why}` if the file violates its format, and reading beyond the end of the file throws as well. Callers get
  # a `Situ.Error`.
  alias Situ.Error

  @typedoc "The code of the errors, and the name of the format in error messages."
  @type format :: {kind :: atom(), name :: String.t()}
  @typedoc "Reads `n` bytes at an offset of the file."
  @type read :: (at :: integer(), n :: non_neg_integer() -> binary())
  @type t :: {size :: non_neg_integer(), read()}

  @doc "Calls `fun` with the open file and returns its result. Errors: `:io`, and the error of the format."
  @spec with_file(Path.t(), format(), (t() -> value)) :: {:ok, value} | {:error, Error.t()}
        when value: term()
  def with_file(path, format, fun) do
    catch_errors(path, format, fn ->
      {file, input} = open_file(path, format)

      try do
        fun.(input)
      after
        :file.close(file)
      end
    end)
  end

  @doc """
  Returns rows as a lazy enumerable. `start` builds the initial state from the open file. `next` returns some rows and
  the next state, or `:done`. Raises `Situ.Error`: `:io`, or the error of the format.
  """
  @spec stream_rows(Path.t(), format(), (t() -> state), (state -> {[row], state} | :done)) ::
          Enumerable.t()
        when state: term(), row: term()
  def stream_rows(path, format, start, next) do
    Stream.resource(
      fn -> raise_errors(path, format, fn -> start_reader(path, format, start) end) end,
      fn {file, state} ->
        raise_errors(path, format, fn ->
          case next.(state) do
            {rows, state} -> {rows, {file, state}}
            :done -> {:halt, {file, state}}
          end
        end)
      end,
      fn {file, _state} -> :file.close(file) end
    )
  end

  # If `start` throws, `Stream.resource/3` never calls the function that closes the file.
  defp start_reader(path, format, start) do
    {file, input} = open_file(path, format)

    try do
      {file, start.(input)}
    catch
      why ->
        :file.close(file)
        throw(why)
    end
  end

  defp open_file(path, {kind, _name}) do
    with {:ok, file} <- :file.open(path, [:read, :raw, :binary]),
         {:ok, size} <- :file.position(file, :eof) do
      {file, {size, &read_bytes(file, {size, kind}, &1, &2)}}
    else
      {:error, reason} -> throw({:io, reason})
    end
  end

  defp read_bytes(_file, _bounds, _at, 0), do: ""

  defp read_bytes(file, {size, kind}, at, n) do
    if at < 0 or n < 0 or at + n > size, do: throw({kind, "it is truncated"})

    case :file.pread(file, at, n) do
      {:ok, bytes} when byte_size(bytes) == n -> bytes
      {:error, reason} -> throw({:io, reason})
      _ -> throw({kind, "it is truncated"})
    end
  end

  defp raise_errors(path, format, fun), do: path |> catch_errors(format, fun) |> Error.unwrap!()

  defp catch_errors(path, {kind, name}, fun) do
    {:ok, fun.()}
  catch
    {^kind, why} ->
      {:error, Error.new(kind, "#{path} cannot be read as #{name}", why: why)}

    {:io, reason} ->
      why = to_string(:file.format_error(reason))
      {:error, Error.new(:io, "cannot read #{path}", why: why)}
  end
end
