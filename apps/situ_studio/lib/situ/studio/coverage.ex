defmodule Situ.Studio.Coverage do
  @moduledoc false
  # Finds streams that begin noticeably later or end noticeably earlier than their recording, such
  # as a camera that was switched on late or a microphone that failed. Pure.
  alias Situ.Studio.{StreamInfo, StreamReader}

  # Shorter differences are ignored, as are differences of a few periods, which the stream's own rate explains.
  @part 0.01
  @periods 3

  @typedoc "Times in ns as strings, the format that the page reads."
  @type t :: %{optional(stream :: String.t()) => %{optional(String.t()) => String.t()}}

  @doc """
  Returns the late and early times by stream; empty for live sources, whose streams have not ended
  yet.

      iex> stream = fn name, first, last ->
      ...>   %Situ.Studio.StreamInfo{name: name, shape: :signal, first: first, last: last, count: 99}
      ...> end
      iex> streams = [stream.("Whole", 0, 1_000), stream.("Late", 400, 998), stream.("Short", 0, 700)]
      iex> Situ.Studio.Coverage.find_partial_streams(streams, %{from: 0, to: 1_000, live: false})
      %{"Late" => %{"first" => "400"}, "Short" => %{"last" => "700"}}
      iex> rare = %{stream.("Now and then", 0, 700) | count: 4}
      iex> Situ.Studio.Coverage.find_partial_streams([rare], %{from: 0, to: 1_000, live: false})
      %{}
  """
  @spec find_partial_streams([StreamInfo.t()], StreamReader.extent() | map()) :: t()
  def find_partial_streams(_, %{live: true}), do: %{}

  def find_partial_streams(streams, %{from: from, to: to}) do
    for %{first: first, last: last, count: count} = s when first != nil and count > 1 <- streams,
        slack = max((to - from) * @part, @periods * (last - first) / (count - 1)),
        ends = format_ends(first - from > slack && first, to - last > slack && last),
        ends != %{},
        into: %{},
        do: {s.name, ends}
  end

  @doc """
  Returns the time of the first and the last message of all streams as strings, or `nil` if no stream has messages.

      iex> stream = fn first, last -> %Situ.Studio.StreamInfo{name: "", shape: :signal, first: first, last: last} end
      iex> Situ.Studio.Coverage.total_extent([stream.(5, 9), stream.(nil, nil), stream.(7, nil)])
      %{from: "5", to: "9"}
      iex> Situ.Studio.Coverage.total_extent([stream.(5, 5)])
      %{from: "5", to: "6"}
      iex> Situ.Studio.Coverage.total_extent([stream.(nil, nil)])
      nil
  """
  @spec total_extent([StreamInfo.t()]) :: %{from: String.t(), to: String.t()} | nil
  def total_extent(streams) do
    case for %{first: first, last: last} when first != nil <- streams, do: {first, last || first} do
      [] ->
        nil

      some ->
        from = some |> Enum.map(&elem(&1, 0)) |> Enum.min()
        to = some |> Enum.map(&elem(&1, 1)) |> Enum.max()
        %{from: Integer.to_string(from), to: Integer.to_string(max(to, from + 1))}
    end
  end

  defp format_ends(first, last) do
    for {name, time} when is_integer(time) <- [{"first", first}, {"last", last}],
        into: %{},
        do: {name, Integer.to_string(time)}
  end
end
