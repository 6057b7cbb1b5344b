defmodule Situ.Media.NutTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Media.Nut
  alias Situ.Media.Nut.{Demuxer, Muxer}

  doctest Situ.Media.Nut
  doctest Situ.Media.Nut.Muxer

  @streams [
    %{id: 0, class: :video, fourcc: <<"BGR", 24>>, width: 4, height: 2},
    %{id: 1, class: :audio, fourcc: <<"PSD", 16>>, rate: 16_000, channels: 1}
  ]

  # Returns exactly the requested bytes or the end, like a socket.
  defp reader(bytes) do
    {:ok, agent} = Agent.start_link(fn -> bytes end)

    fn n ->
      Agent.get_and_update(agent, fn
        <<head::binary-size(n), rest::binary>> -> {{:ok, head}, rest}
        rest -> {{:error, :closed}, rest}
      end)
    end
  end

  defp read_all({:ok, demuxer}, frames) do
    case Demuxer.next_frame(demuxer) do
      {:ok, frame, demuxer} -> read_all({:ok, demuxer}, [frame | frames])
      {:error, reason} -> {reason, Enum.reverse(frames)}
    end
  end

  defp read_all({:error, reason}, frames), do: {reason, frames}

  property "numbers survive a round trip" do
    forall n <- non_neg_integer() do
      assert Nut.take_varint(Nut.encode_varint(n) <> "x") == {n, "x"}
    end
  end

  property "frames survive a round trip with their times" do
    forall frames <- list({integer(0, 1), integer(0, 4_000_000_000_000_000_000), binary()}) do
      bytes =
        IO.iodata_to_binary([
          Muxer.encode_header(@streams),
          for({id, time, data} <- frames, do: Muxer.encode_frame(id, time, data))
        ])

      {reason, read} = read_all(Demuxer.open(reader(bytes)), [])
      assert reason == :eof
      assert Enum.map(read, &{&1.stream, &1.time, &1.data}) == frames
    end
  end

  property "damaged bytes never raise and end with a reason" do
    whole =
      IO.iodata_to_binary([
        Muxer.encode_header(@streams),
        for(i <- 0..5, do: Muxer.encode_frame(rem(i, 2), i * 1000, :binary.copy(<<i>>, 24)))
      ])

    forall {at, byte} <- {integer(0, byte_size(whole) - 1), integer(0, 255)} do
      <<head::binary-size(at), _, tail::binary>> = whole
      {reason, frames} = read_all(Demuxer.open(reader(head <> <<byte>> <> tail)), [])
      assert reason != nil and length(frames) <= 6
    end
  end

  test "rejects garbage" do
    assert {:error, :not_nut} = Demuxer.open(reader(:binary.copy("x", 100)))
    assert {:error, :eof} = Demuxer.open(reader(""))
  end

  test "rejects a frame that claims more than the limit before allocating memory" do
    bytes =
      IO.iodata_to_binary([Muxer.encode_header(@streams), Muxer.encode_frame(0, 0, <<0::800>>)])

    {:ok, demuxer} = Demuxer.open(reader(bytes), max_frame: 99)
    assert {:error, {:frame_too_large, 100}} = Demuxer.next_frame(demuxer)
  end

  test "reads ffmpeg's sample and pixel formats, elided headers and exact times" do
    {bytes, 0} =
      System.cmd("ffmpeg", ~w(-v error -f lavfi -i testsrc=size=6x4:rate=30000/1001:duration=0.2
        -f lavfi -i sine=duration=0.2:sample_rate=44100 -c:v rawvideo -pix_fmt rgb24
        -c:a pcm_s16le -f nut pipe:1))

    {:ok, demuxer} = Demuxer.open(reader(bytes))

    assert %{0 => %{class: :video, width: 6, height: 4}, 1 => audio} =
             Demuxer.list_streams(demuxer)

    assert %{class: :audio, rate: 44_100, channels: 1} = audio
    {:eof, frames} = read_all({:ok, demuxer}, [])
    video = for %{stream: 0} = f <- frames, do: f
    assert Enum.all?(video, &(byte_size(&1.data) == 72))

    assert Enum.map(video, & &1.time) ==
             for(i <- 0..(length(video) - 1), do: round(i * 1001 / 30_000 * 1.0e9))

    samples = for %{stream: 1} = f <- frames, do: div(byte_size(f.data), 2)
    assert Enum.sum(samples) == 8820
  end
end
