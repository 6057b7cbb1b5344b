defmodule Situ.Annotation.ExchangeTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  import Situ.Annotation.Test.Annotating
  alias Situ.Annotation
  alias Situ.Annotation.{Exchange, Layer, Schema}

  doctest Situ.Annotation.Exchange

  @moduletag :tmp_dir
  @ms 1_000_000
  @formats [:eaf, :textgrid, :webvtt, :srt, :label_studio, :csv]

  # Returns the parts that each format can hold: values, tracks and milliseconds.
  defp plain(layer) do
    for a <- Layer.annotations(layer), do: {a.from, a.to, a.track, a.values}
  end

  defp layer_ms(items) do
    {:ok, layer} = Layer.new(schema())

    Enum.reduce(items, layer, fn {from, length, track, words}, layer ->
      values = %{"Speech" => "laughs", "Words" => "x" <> words, "Sure" => 2.5, "Loud" => true}

      case Layer.add(layer, Annotation.new(from * @ms, (from + length) * @ms, track, values)) do
        {:ok, layer, _} -> layer
        {:error, %{code: :overlap}} -> layer
      end
    end)
  end

  defp items do
    words = one_of(["", "a b", "\"quoted\"", "<b>&amp;", "line\nbreak", "ä€😀", "a,b;c", "--> 1"])
    list({integer(0, 5_000), integer(1, 900), one_of(["P1", "P 2", "Ü<&"]), words})
  end

  for format <- @formats do
    property "#{format} keeps annotations with millisecond times", numtests: 60 do
      forall items <- items() do
        layer = layer_ms(items)
        {:ok, text, _} = Exchange.encode(layer, unquote(format), origin: 0)
        {:ok, again, _} = Exchange.decode(text, unquote(format), schema: schema(), origin: 0)

        assert Enum.sort(plain(again)) == Enum.sort(plain(layer))
      end
    end

    property "#{format} rejects or reads truncated and altered text, and never raises",
      numtests: 60 do
      forall {cut, at, byte} <- {integer(0, 400), integer(0, 3_000), integer(0, 255)} do
        layer =
          layer_ms([{0, 10, "P1", "one"}, {10, 10, "P1", "two"}, {5, 30, "P2", "\"three\""}])

        {:ok, text, _} = Exchange.encode(layer, unquote(format), origin: 0)
        size = byte_size(text)
        short = binary_part(text, 0, max(size - cut, 0))
        at = rem(at, size)
        <<before::binary-size(at), _, rest::binary>> = text

        for bytes <- [short, before <> <<byte>> <> rest] do
          case Exchange.decode(bytes, unquote(format)) do
            {:ok, %Layer{}, losses} -> assert is_list(losses)
            {:error, %Situ.Error{}} -> :ok
          end
        end

        true
      end
    end
  end

  test "csv keeps everything, to the nanosecond", %{tmp_dir: root} do
    {:ok, layer} =
      Layer.new(schema(), [
        Annotation.new(1_700_000_000_000_000_001, 1_700_000_000_000_000_005, "P1", %{},
          by: "A, \"B\"",
          confidence: 0.5,
          note: "x\ny",
          proposed?: true
        ),
        Annotation.new(1_700_000_000_000_000_005, 1_700_000_000_000_000_009, "P1", %{
          "Words" => " blank "
        })
      ])

    path = Path.join(root, "x.csv")
    assert {:ok, []} = Exchange.write(layer, path)
    assert {:ok, again, []} = Exchange.read(path, schema: schema())
    strip = fn layer -> for a <- Layer.annotations(layer), do: %{a | id: nil} end
    assert strip.(again) == strip.(layer)
  end

  test "keeps schema and origin in ELAN and Label Studio files", %{tmp_dir: root} do
    start = 1_700_000_000_000_000_000

    {:ok, layer} =
      Layer.new(schema(), [
        Annotation.new(start + 5 * @ms, start + 9 * @ms, "P1", %{"Words" => "w"}, by: "me")
      ])

    for ending <- ["eaf", "json"] do
      path = Path.join(root, "x." <> ending)
      {:ok, []} = Exchange.write(layer, path, origin: start)
      {:ok, again, []} = Exchange.read(path)
      assert again.schema == schema()
      assert plain(again) == plain(layer)
      assert hd(Layer.annotations(again)).by == "me"
    end
  end

  test "rejects a csv column without a name" do
    for text <- [
          "track,from,to,\r\nA,0,1,x\r\n",
          "track,from_s,to_s,\r\nA,0,1,x\r\n"
        ] do
      assert {:error, %Situ.Error{}} = Exchange.decode(text, :csv)
    end
  end

  test "reports losses" do
    {:ok, layer} =
      Layer.new(Schema.text("Words"), [
        Annotation.new(0, 1_500_000, "A", %{"Words" => ""},
          by: "me",
          confidence: 0.5,
          note: "n",
          proposed?: true
        ),
        Annotation.new(2_000_000, 2_000_000, "A", %{"Words" => "point"})
      ])

    for {format, words} <- [
          eaf: ["milliseconds", "confidences", "notes", "proposals"],
          textgrid: ["annotators", "confidences", "notes", "proposals", "empty label", "points"],
          webvtt: ["milliseconds", "annotators", "notes", "points"],
          srt: ["milliseconds", "annotators", "notes", "points"],
          label_studio: ["notes"],
          csv: []
        ] do
      {:ok, _, losses} = Exchange.encode(layer, format, origin: 0)
      for word <- words, do: assert(Enum.any?(losses, &(&1 =~ word)), "#{format}: #{word}")
      if words == [], do: assert(losses == [])
    end
  end

  test "rejects entity bombs, external entities and deep nesting" do
    bomb = """
    <?xml version="1.0"?>
    <!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;">]>
    <ANNOTATION_DOCUMENT>&c;</ANNOTATION_DOCUMENT>
    """

    external =
      ~s(<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><ANNOTATION_DOCUMENT>&a;</ANNOTATION_DOCUMENT>)

    wide = :unicode.characters_to_binary("\uFEFF" <> bomb, :utf8, {:utf16, :big})
    deep = String.duplicate("<a>", 100_000)

    for text <- [bomb, external, wide],
        do:
          assert({:error, %{code: :bad_file, why: why}} = Exchange.decode(text, :eaf)) &&
            assert(why =~ "document type")

    assert {:error, %{code: :bad_file}} = Exchange.decode(deep, :eaf)
    assert {:error, %{code: :bad_file}} = Exchange.decode("<html/>", :eaf)
    assert {:error, %{code: :bad_file}} = Exchange.decode("not xml", :eaf)
  end

  test "times ELAN's dependent tiers by their parent tier" do
    text = """
    <ANNOTATION_DOCUMENT><HEADER/><TIME_ORDER><TIME_SLOT TIME_SLOT_ID="t1" TIME_VALUE="0"/>
    <TIME_SLOT TIME_SLOT_ID="t2" TIME_VALUE="1500"/><TIME_SLOT TIME_SLOT_ID="t3"/></TIME_ORDER>
    <TIER TIER_ID="K"><ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a1" TIME_SLOT_REF1="t1" TIME_SLOT_REF2="t2">
    <ANNOTATION_VALUE>hello</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>
    <ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a9" TIME_SLOT_REF1="t2" TIME_SLOT_REF2="t3">
    <ANNOTATION_VALUE>untimed</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION></TIER>
    <TIER TIER_ID="gloss"><ANNOTATION><REF_ANNOTATION ANNOTATION_ID="a2" ANNOTATION_REF="a1">
    <ANNOTATION_VALUE>greeting</ANNOTATION_VALUE></REF_ANNOTATION></ANNOTATION></TIER></ANNOTATION_DOCUMENT>
    """

    {:ok, layer, losses} = Exchange.decode(text, :eaf)

    assert [
             {0, 1_500_000_000, "K", %{"Value" => "hello"}},
             {0, 1_500_000_000, "gloss", %{"Value" => "greeting"}}
           ] = plain(layer)

    assert [loss] = losses
    assert loss =~ "no times"
  end

  test "reads Praat's short form, UTF-16 and overlapping tiers with the same name" do
    short = """
    File type = "ooTextFile"
    Object class = "TextGrid"

    0
    2.5
    <exists>
    2
    "IntervalTier"
    "say ""it\"""
    0
    2.5
    2
    0
    1.000000001
    "hé"
    1.000000001
    2.5
    ""
    "TextTier"
    "bell"
    0
    2.5
    1
    2
    "ding"
    """

    utf16 = :unicode.characters_to_binary("\uFEFF" <> short, :utf8, {:utf16, :little})

    for text <- [short, utf16] do
      {:ok, layer, []} = Exchange.decode(text, :textgrid)

      assert plain(layer) == [
               {0, 1_000_000_001, "say \"it\"", %{"Value" => "hé"}},
               {2_000_000_000, 2_000_000_000, "bell", %{"Value" => "ding"}}
             ]
    end
  end

  test "reads subtitles without a speaker, overlapping ones, and values outside the schema" do
    text =
      "WEBVTT - title\n\nNOTE x\n\n00:01.000 --> 00:02.000 align:start\n<b>Hi</b> &amp; bye\n\n" <>
        "00:01.500 --> 00:03.000\nthere\n"

    {:ok, layer, losses} = Exchange.decode(text, :webvtt)

    assert [{_, _, "Cues", %{"Value" => "Hi & bye"}}, {_, _, "Cues (2)", %{"Value" => "there"}}] =
             plain(layer)

    assert [loss] = losses
    assert loss =~ "overlap"
    {:ok, layer, losses} = Exchange.decode(text, :webvtt, schema: Schema.finite("S", ["there"]))
    assert [{_, _, _, %{"S" => "there"}}] = plain(layer)
    assert Enum.any?(losses, &(&1 =~ "do not fit the schema"))
  end

  test "rejects missing, oversized and unknown files", %{tmp_dir: root} do
    assert {:error, %{code: :not_found}} = Exchange.read(Path.join(root, "none.eaf"))
    assert {:error, %{code: :unknown_format}} = Exchange.read(Path.join(root, "x.doc"))
    big = Path.join(root, "big.csv")
    {:ok, device} = :file.open(big, [:write, :raw])
    {:ok, _} = :file.position(device, 70_000_000)
    :ok = :file.truncate(device)
    :ok = :file.close(device)
    assert {:error, %{code: :bad_file}} = Exchange.read(big)
    {:ok, layer} = Layer.new(schema())
    assert {:error, %{code: :not_saved}} = Exchange.write(layer, Path.join(root, "no/x.eaf"))
  end
end
