defmodule Situ.EditLog.LinesTest do
  # Anybody with access to a folder may have written its logs.
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.EditLog.{Changes, Entry, Lines}

  defp terms do
    one_of([
      integer(),
      boolean(),
      nil,
      "a",
      "name",
      [],
      ["a", "b"],
      %{},
      %{"name" => "a"},
      [%{"name" => "b"}],
      [1, "a"]
    ])
  end

  property "any bytes are entries or damage" do
    forall {bytes, cut} <- {list(integer(0, 255)), integer(0, 200)} do
      line = IO.iodata_to_binary(Lines.encode(Entry.to_json(%{Entry.new("edit", %{}) | n: 1})))
      text = binary_part(line, 0, min(cut, byte_size(line))) <> :erlang.list_to_binary(bytes)

      case Lines.parse_entries(text, 1) do
        {:ok, entries, size} -> assert length(entries) <= 1 and size <= byte_size(text)
        {:damaged, at} -> assert at <= byte_size(text)
      end
    end
  end

  property "any change applies, conflicts, or is not a change" do
    kinds = one_of(~w(add remove set rename order move))

    forall {kind, path, a, b, document} <-
             {kinds, list(one_of(["a", "b", "c", 7])), terms(), terms(),
              list({one_of(~w(a b)), terms()})} do
      change = [kind, path, a, b]

      if Changes.change?(change) do
        case Changes.apply_change(Map.new(document), change) do
          {:ok, _} -> true
          :conflict -> assert %{} = Changes.force_change(Map.new(document), change)
        end
      else
        json = %{"n" => 1, "kind" => "edit", "do" => %{"changes" => [change]}}
        assert Entry.parse(json) == :error
      end
    end
  end
end
