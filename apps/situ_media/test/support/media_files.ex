defmodule Situ.Media.TestFiles do
  @moduledoc "Real files for tests, and readers that run a decoder to its end."
  alias Situ.Media.Decoder

  @fixtures Path.expand("../fixtures", __DIR__)

  @spec path(String.t()) :: Path.t()
  def path(name), do: Path.join(@fixtures, name)

  @doc "Everything in a file, in order, and how it ended (`:eof` or a `Situ.Error`)."
  @spec read(Path.t(), keyword()) :: {[{:video | :audio, integer(), struct()}], :eof | term()}
  def read(path, opts \\ []) do
    case Decoder.open(path, opts) do
      {:ok, decoder} -> collect(Decoder.next(decoder), [])
      {:error, error} -> {[], error}
    end
  end

  defp collect({kind, time, data, decoder}, items),
    do: collect(Decoder.next(decoder), [{kind, time, data} | items])

  defp collect({:eof, decoder}, items), do: finish(decoder, items, :eof)
  defp collect({:error, error, decoder}, items), do: finish(decoder, items, error)

  defp finish(decoder, items, ending) do
    Decoder.close(decoder)
    {Enum.reverse(items), ending}
  end

  @doc "The times of one kind."
  def times(items, kind), do: for({^kind, time, _} <- items, do: time)

  @doc "Frames of sound in all."
  def frames(items), do: Enum.sum(for {:audio, _, b} <- items, do: Situ.AudioBuffer.frames(b))

  @doc "Runs ffmpeg to make a test file."
  def ffmpeg!(args) do
    {_, 0} = System.cmd("ffmpeg", ~w(-v error -nostdin -y) ++ args)
    :ok
  end
end
