defmodule Situ.Space.GpxTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  doctest Situ.Space.Gpx
  alias Situ.{GeoPoint, Store}
  alias Situ.Space.Gpx

  @walk Path.expand("../../data/cerknicko-jezero.gpx", __DIR__)

  # 295 track points, 293 of them with a time; the numbers of the first and last point are in the file.
  test "opens a real track as a recording, seeks and reads in parts" do
    assert {:ok, store} = Store.open(@walk)
    assert [%{name: "Track", type: GeoPoint, count: count} = info] = Store.streams(store)
    messages = store |> Store.messages("Track") |> Enum.to_list()
    assert length(messages) == count
    times = Enum.map(messages, & &1.originating_time)
    assert times == Enum.sort(times) and times == Enum.uniq(times)
    assert {hd(times), List.last(times)} == {info.first, info.last}
    assert Enum.all?(messages, &match?(%GeoPoint{}, &1.data))
    {:ok, gpx} = Gpx.open(@walk, [])
    {:ok, ordinal} = Gpx.seek(gpx, info, Enum.at(times, 100) - 1)
    assert ordinal == 100
    assert {:ok, [a, b], 102} = Gpx.read(gpx, info, 100, info.last, 2, [])
    assert [a.originating_time, b.originating_time] == Enum.slice(times, 100, 2)
    assert {:ok, [], ^count} = Gpx.read(gpx, info, count, info.last, 2, [])
  end

  test "counts points without a valid time and sorts the others by time" do
    point = fn lat, time -> ~s(<trkpt lat="#{lat}" lon="14">#{time}</trkpt>) end
    time = &"<time>2026-01-01T00:00:0#{&1}Z</time>"

    xml =
      "<gpx><trk>" <>
        Enum.join([
          point.(2, time.(2)),
          point.(1, time.(1)),
          point.(9, time.(1)),
          point.(95, time.(3)),
          point.("x", time.(4)),
          point.(String.duplicate("9", 400), time.(5)),
          point.(3, ""),
          point.(3, "<time>noon</time>")
        ]) <> "</trk></gpx>"

    assert {:ok, points, 5} = Gpx.parse(xml)
    assert Enum.map(points, fn {_, p} -> p.latitude end) == [1.0, 2.0]
  end

  test "a file that is not GPX is a readable error" do
    bomb = ~s(<!DOCTYPE gpx [<!ENTITY a "aaaa">]><gpx>&a;</gpx>)

    for {text, words} <- [
          {"", "XML"},
          {"<gpx><trk>", "XML"},
          {"<html></html>", "its first element is not gpx"},
          {bomb, "document type"}
        ] do
      assert {:error, error} = Gpx.parse(text)
      assert error.code == :bad_gpx and error.what =~ words, "#{text}: #{error.what}"
    end
  end

  property "no bytes crash it" do
    forall bytes <- binary() do
      match?({:error, %{code: :bad_gpx}}, Gpx.parse(bytes))
    end
  end
end
