defmodule Situ.Bridge.Test.PsiFiles do
  @moduledoc "Writes \\psi store files by the rules, in states that no genuine store here has."

  @epoch 621_355_968_000_000_000
  @utc 0x4000_0000_0000_0000

  @doc "Converts nanoseconds since 1970 to .NET's time bits."
  def time(ns), do: div(ns, 100) + @epoch + @utc

  @doc "Writes a store with these catalog entries and data blocks."
  def write!(folder, name, catalog, data) do
    File.mkdir_p!(folder)

    for {kind, bytes} <- [{"Catalog", [runtime() | catalog]}, {"Data", data}, {"Index", []}] do
      bytes = IO.iodata_to_binary(bytes)
      page = 4096 - rem(byte_size(bytes), 4096)

      File.write!(Path.join(folder, "#{name}.#{kind}_000000.psi"), [
        bytes,
        <<0::size(page)-unit(8)>>
      ])
    end

    folder
  end

  @doc "Builds a message. Both of its times are `bits`, in .NET's form."
  def message(id, seq, bits, data),
    do: block([<<id::little-32, seq::little-32, bits::little-64, bits::little-64>>, data])

  @doc "Builds the catalog entry of a closed stream in the form of `version`."
  def stream(version, name, id, type, count) do
    # Version 1 added supplemental metadata. Version 2 changed the count, sizes and latencies.
    {counts, averages} =
      if version >= 2,
        do: {<<count::little-64, count * 4::little-64, count * 30::little-64>>, ""},
        else: {<<count::little-32>>, <<4::little-32, 3::little-32>>}

    supplemental = if version >= 1, do: [text(nil), <<0::32>>], else: []
    times = for ns <- [0, 1000, 0, 1000], do: <<time(ns)::little-64>>
    opened = [<<time(0)::little-64>>, <<time(2000)::little-64>>]
    block([header(name, id, type, version, 2, 0), opened, counts, times, averages, supplemental])
  end

  defp runtime, do: block(header("Microsoft.Psi, Version=0.19.100.1", 0, nil, 19, 0, 1))

  defp header(name, id, type, version, flags, kind) do
    start = [text(name), <<id::little-32>>, text(type), <<version::little-32>>, text(nil)]
    [start, <<2::little-32, flags::little-16, kind::little-16>>]
  end

  defp text(nil), do: <<-1::little-signed-32>>
  defp text(text), do: [<<byte_size(text)::little-32>>, text]

  defp block(parts) do
    bytes = IO.iodata_to_binary(parts)
    padding = rem(4 - rem(byte_size(bytes), 4), 4)
    [<<byte_size(bytes) + padding::little-32>>, bytes, <<0::size(padding)-unit(8)>>]
  end
end
