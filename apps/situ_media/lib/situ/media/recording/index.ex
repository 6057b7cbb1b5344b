defmodule Situ.Media.Recording.Index do
  @moduledoc """
  Where every picture and the sound of a media file lie, found by reading its packets without decoding them.

  `pictures` and `keys` are packed numbers: the times of all pictures (media time, ns, increasing) and the ordinals of those
  a decoder can begin with. Two hours at 24 pictures a second take 1.4 MB, shared by all who hold them.

      iex> index = %Situ.Media.Recording.Index{
      ...>   pictures: <<0::64, 40::64, 80::64, 120::64>>, keys: <<0::32, 2::32>>}
      iex> alias Situ.Media.Recording.Index
      iex> {Index.count(index), Index.time(index, 2), Index.seek(index, 41), Index.nearest(index, 55), Index.key(index, 3)}
      {4, 80, 2, 1, 2}
  """
  alias Situ.Error
  alias Situ.Media.{FFmpeg, FileInfo, Nut}

  defstruct pictures: <<>>, keys: <<>>, picture_bytes: 0, sound_end: nil, sound_bytes: 0

  @type t :: %__MODULE__{
          pictures: binary(),
          keys: binary(),
          picture_bytes: non_neg_integer(),
          sound_end: Situ.Time.t() | nil,
          sound_bytes: non_neg_integer()
        }

  @seconds 120
  @packets "format=start_time:stream=index,time_base:packet=stream_index,pts,dts,duration,size,flags"
  @frames "frame=best_effort_timestamp,key_frame"

  @doc "Reads the packets of the file. Gives up after two minutes."
  @spec read(Path.t(), FileInfo.t()) :: {:ok, t()} | {:error, Error.t()}
  def read(path, %FileInfo{} = info) do
    with {:ok, packets} <- probe(path, info, ["-show_entries", @packets]) do
      rows = rows(packets)

      if vague?(rows, info),
        do: {:ok, build(rows ++ frames(path, info), info)},
        else: {:ok, build(rows, info)}
    end
  end

  # Some old containers (AVI, MPEG-PS) leave out times, and only a decoder can tell which picture comes when. Where that
  # takes too long, the order of the packets has to do.
  defp frames(path, info) do
    args = ["-select_streams", "#{info.video.index}", "-show_entries", @frames]

    case probe(path, info, args) do
      {:ok, out} -> rows(out)
      {:error, _} -> []
    end
  end

  defp probe(path, info, entries) do
    args =
      ~w(-k 1 #{@seconds} ffprobe -hide_banner -loglevel quiet -of compact=nokey=0:item_sep=;) ++
        entries ++ FFmpeg.local_file(path)

    case System.cmd("timeout", args, env: []) do
      # What ffprobe could list is what can be read, also when it stumbled at the end.
      {out, status} when status != 124 and out != "" -> {:ok, out}
      {_, _} -> {:error, unreadable(info)}
    end
  end

  defp rows(text), do: text |> String.split("\n", trim: true) |> Enum.map(&row/1)

  defp vague?(_rows, %{video: nil}), do: false

  defp vague?(rows, %{video: %{index: id}}),
    do: rows |> of(id) |> Enum.any?(&(number(&1["pts"]) == nil))

  defp build(rows, info) do
    bases = for {"stream", %{"index" => i} = r} <- rows, into: %{}, do: {i, base(r["time_base"])}

    zero =
      Enum.find_value(rows, 0, fn
        {"format", %{"start_time" => t}} -> not info.exact? && microseconds(t)
        _ -> nil
      end) || 0

    %__MODULE__{} |> add_pictures(info, rows, bases, zero) |> add_sound(info, rows, bases, zero)
  end

  # "packet;stream_index=0;pts=512;..."; ffprobe separates side data by another "|".
  defp row(line) do
    [kind | fields] = line |> String.split("|", parts: 2) |> hd() |> String.split(";")

    {kind,
     for(
       f <- fields,
       [key, value] <- [String.split(f, "=", parts: 2)],
       into: %{},
       do: {key, value}
     )}
  end

  defp base(text) do
    case text && String.split(text, "/") |> Enum.map(&Integer.parse/1) do
      [{num, ""}, {den, ""}] when num > 0 and den > 0 -> {num, den}
      _ -> nil
    end
  end

  defp microseconds(text) do
    case Float.parse(text) do
      {seconds, ""} -> round(seconds * 1.0e6)
      _ -> nil
    end
  end

  defp add_pictures(index, %{video: nil}, _rows, _bases, _zero), do: index

  defp add_pictures(index, %{video: %{index: id}}, rows, bases, zero) do
    packets = of(rows, id)
    frames = for {"frame", row} <- rows, do: row
    base = bases["#{id}"]

    pictures =
      for row <- if(frames == [], do: packets, else: frames),
          not discarded?(row),
          time = time(row, base, zero),
          time >= 0,
          do: {time, key?(row)}

    pictures = pictures |> Enum.sort() |> Enum.dedup_by(&elem(&1, 0))

    keys = for {{_, true}, ordinal} <- Enum.with_index(pictures), into: <<>>, do: <<ordinal::32>>

    %{
      index
      | pictures: for({time, _} <- pictures, into: <<>>, do: <<time::64>>),
        keys: keys,
        picture_bytes: bytes(packets)
    }
  end

  defp add_sound(index, %{audio: nil}, _rows, _bases, _zero), do: index

  defp add_sound(index, %{audio: %{index: id} = audio} = info, rows, bases, zero) do
    mine = of(rows, id)

    ends =
      for packet <- mine,
          not discarded?(packet),
          time = time(packet, bases["#{id}"], zero),
          do: time + length_ns(packet, bases["#{id}"])

    # MP4 and its kin say exactly how long the sound is; others are believed packet by packet.
    stated = if match?("mov" <> _, info.format), do: audio.duration
    %{index | sound_end: stated || Enum.max(ends, fn -> 0 end), sound_bytes: bytes(mine)}
  end

  defp of(rows, id) do
    id = "#{id}"
    for {"packet", %{"stream_index" => ^id} = row} <- rows, do: row
  end

  defp bytes(packets), do: packets |> Enum.map(&(number(&1["size"]) || 0)) |> Enum.sum()
  defp key?(row), do: row["key_frame"] == "1" or String.starts_with?(row["flags"] || "", "K")
  defp discarded?(row), do: String.contains?(row["flags"] || "", "D")

  # As ffmpeg's `-start_at_zero` does it: the file's start, in microseconds, rounded to the stream's ticks.
  defp time(row, {num, den} = base, zero) do
    case number(row["pts"] || row["best_effort_timestamp"]) || number(row["dts"]) do
      nil ->
        nil

      ticks ->
        Nut.to_ns(
          ticks - Integer.floor_div(2 * zero * den + num * 1_000_000, 2 * num * 1_000_000),
          base
        )
    end
  end

  defp time(_row, nil, _zero), do: nil

  defp length_ns(packet, base), do: Nut.to_ns(number(packet["duration"]) || 0, base)

  defp number(nil), do: nil

  defp number(text) do
    case Integer.parse(text) do
      {n, ""} -> n
      _ -> nil
    end
  end

  defp unreadable(info) do
    Error.new(:unreadable_media, "cannot list what is in #{info.name}",
      why: "FFmpeg found no packets in it, or took longer than #{@seconds} s",
      fix: "check that the file is whole: ffprobe #{info.name}"
    )
  end

  @doc "How many pictures there are."
  @spec count(t()) :: non_neg_integer()
  def count(index), do: div(byte_size(index.pictures), 8)

  @doc "The media time of a picture."
  @spec time(t(), non_neg_integer()) :: Situ.Time.t()
  def time(index, ordinal) do
    <<time::64>> = binary_part(index.pictures, ordinal * 8, 8)
    time
  end

  @doc "The first picture at or after a media time; the count when there is none."
  @spec seek(t(), integer()) :: non_neg_integer()
  def seek(index, time), do: search(&(time(index, &1) >= time), 0, count(index))

  @doc "The picture whose time is nearest."
  @spec nearest(t(), integer()) :: non_neg_integer()
  def nearest(index, time) do
    case seek(index, time) do
      0 ->
        0

      after_it ->
        before = after_it - 1

        if after_it < count(index) and time(index, after_it) - time <= time - time(index, before),
          do: after_it,
          else: before
    end
  end

  @doc "The last picture at or before `ordinal` that a decoder can begin with; 0 when none is marked."
  @spec key(t(), non_neg_integer()) :: non_neg_integer()
  def key(index, ordinal) do
    later = search(&(key_at(index, &1) > ordinal), 0, div(byte_size(index.keys), 4))
    if later == 0, do: 0, else: key_at(index, later - 1)
  end

  defp key_at(index, i) do
    <<ordinal::32>> = binary_part(index.keys, i * 4, 4)
    ordinal
  end

  # The first i in low..high-1 for which `holds?`, which is true from some point on; `high` when there is none.
  defp search(_holds?, low, low), do: low

  defp search(holds?, low, high) do
    middle = div(low + high, 2)
    if holds?.(middle), do: search(holds?, low, middle), else: search(holds?, middle + 1, high)
  end
end
