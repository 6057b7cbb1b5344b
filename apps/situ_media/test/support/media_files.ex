defmodule Situ.Media.TestFiles do
  @moduledoc "Provides real files for tests, and helpers that run a decoder to its end."
  alias Situ.Media.Decoder

  @fixtures Path.expand("../fixtures", __DIR__)

  @spec path(String.t()) :: Path.t()
  def path(name), do: Path.join(@fixtures, name)

  @doc "Returns all items of a file in order, and how it ended (`:eof` or a `Situ.Error`)."
  @spec read(Path.t(), keyword()) :: {[{:video | :audio, integer(), struct()}], :eof | term()}
  def read(path, opts \\ []) do
    case Decoder.open(path, opts) do
      {:ok, decoder} -> collect(Decoder.next_item(decoder), [])
      {:error, error} -> {[], error}
    end
  end

  defp collect({kind, time, data, decoder}, items),
    do: collect(Decoder.next_item(decoder), [{kind, time, data} | items])

  defp collect({:eof, decoder}, items), do: finish(decoder, items, :eof)
  defp collect({:error, error, decoder}, items), do: finish(decoder, items, error)

  defp finish(decoder, items, ending) do
    Decoder.close(decoder)
    {Enum.reverse(items), ending}
  end

  @doc "Returns the times of one kind."
  def times(items, kind), do: for({^kind, time, _} <- items, do: time)

  @doc "Returns the total number of audio frames."
  def frames(items),
    do: Enum.sum(for {:audio, _, b} <- items, do: Situ.AudioBuffer.frame_count(b))

  @doc "Runs ffmpeg to create a test file."
  def ffmpeg!(args) do
    {_, 0} = System.cmd("ffmpeg", ~w(-v error -nostdin -y) ++ args)
    :ok
  end
end
