defmodule Situ.Bridge.FileTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.File, as: Files

  @moduletag :tmp_dir

  for format <- [:json, :json_lines, :csv, :message_pack] do
    test "writes and reads a #{format} file with its times", %{tmp_dir: dir} do
      path = Path.join(dir, "values")

      {:ok, _} =
        Situ.Pipeline.run(
          fn p ->
            p
            |> Situ.from_enumerable(0..4_999, every: Situ.Time.ms(10))
            |> Files.write(path, format: unquote(format))
          end,
          pipeline: [replay: [interval: {0, :unbounded}]]
        )

      got = Situ.to_list(fn p -> Files.read(p, path, format: unquote(format)) end, times: true)
      assert got == for(i <- 0..4_999, do: {i * 10_000_000, i})
    end

    test "writes an empty stream as a valid #{format} file", %{tmp_dir: dir} do
      path = Path.join(dir, "empty")

      {:ok, _} =
        Situ.Pipeline.run(fn p ->
          p |> Situ.from_enumerable([]) |> Files.write(path, format: unquote(format))
        end)

      assert Enum.to_list(Files.messages(path, unquote(format))) == []

      assert_raise Situ.Error, ~r/no message/, fn ->
        Situ.to_list(fn p -> Files.read(p, path, format: unquote(format)) end)
      end
    end
  end

  test "says once which lists a CSV file omits", %{tmp_dir: dir} do
    path = Path.join(dir, "walk.csv")

    log =
      ExUnit.CaptureLog.capture_log(fn ->
        {:ok, _} =
          Situ.Pipeline.run(fn p ->
            p
            |> Situ.from_enumerable([{1, %{n: 1, at: {0.5, 1.5}}}, {2, %{n: 2, at: {0.5, 1.5}}}])
            |> Files.write(path, format: :csv)
          end)
      end)

    assert length(String.split(log, "no columns for the lists at")) == 2
    assert File.read!(path) =~ "_OriginatingTime_,n\r\n"
  end

  test "reports errors with their position", %{tmp_dir: dir} do
    path = Path.join(dir, "bad.csv")
    File.write!(path, "_OriginatingTime_,_Value_\r\n1971-11-03T00:00:00Z,1\r\nyesterday,2\r\n")
    messages = Files.messages(path, :csv)
    assert [{_, 1}] = Enum.take(messages, 1)
    assert_raise Situ.Error, ~r/cannot be read/, fn -> Enum.to_list(messages) end

    assert_raise Situ.Error, ~r/cannot open/, fn ->
      Enum.to_list(Files.messages(Path.join(dir, "none"), :csv))
    end
  end
end
