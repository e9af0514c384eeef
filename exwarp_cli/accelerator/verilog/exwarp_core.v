// One core of the predictor: MAC units, an adder, a multiplier, and the memory of its own neurons.
//
// A word of weights goes through four stages: its operands are read, multiplied, added up, and added
// to the accumulator. A finished sum gets its bias in the next cycle and is requantised in the one
// after that. Inputs take the multiplier's way: read, multiplied, rounded, written.

`default_nettype none

module exwarp_core #(
    parameter CORE = 0,
    parameter MACS = 10,
    parameter RESIDENT = 1,  // words of weights that the memory holds
    parameter WEIGHT_WORDS = 1,  // words of weights in all
    parameter SCALES = 1,  // multipliers and shifts, of inputs and hidden neurons
    parameter BIASES = 1,
    parameter STATES = 1,  // numbers of the state
    parameter STATE_BITS = 1,
    parameter ADDRESS = 1  // bits of the address of a word of activations
) (
    input wire clk,
    input wire restart,

    input wire state_write,
    input wire [STATE_BITS - 1:0] state_slot,
    input wire signed [31:0] state_value,

    input wire input_start,
    input wire [STATE_BITS - 1:0] input_slot,

    input wire start,  // products
    input wire first,  // word of a neuron
    input wire last,
    input wire hidden,  // layer, whose sums are requantised
    input wire [ADDRESS:0] read_at,  // word of activations
    input wire streamed,
    output wire beyond,
    input wire [8 * MACS - 1:0] held,

    // Activations of all cores, 0 to 127.
    input wire [MACS - 1:0] lane_write,
    input wire [MACS * (ADDRESS + 1) - 1:0] lane_address,
    input wire [7 * MACS - 1:0] lane_value,

    output wire result_valid,
    output wire [6:0] result,
    output wire sum_valid,  // of the last layer
    output wire signed [31:0] sum
);
    localparam [7:0] DIGIT = "0" + CORE;
    localparam WEIGHT_BITS = $clog2(WEIGHT_WORDS + 1);
    localparam SCALE_BITS = $clog2(SCALES + 1);
    localparam BIAS_BITS = $clog2(BIASES + 1);

    // ---- Memories: a word is there in the cycle after its address. ----
    reg [8 * MACS - 1:0] weights [0:RESIDENT - 1];
    reg [39:0] scales [0:SCALES - 1];  // shift, multiplier
    reg signed [31:0] biases [0:BIASES - 1];
    reg signed [31:0] state [0:STATES - 1];
    initial begin
        $readmemh({"memory", DIGIT, "_weights.hex"}, weights);
        $readmemh({"memory", DIGIT, "_scales.hex"}, scales);
        $readmemh({"memory", DIGIT, "_biases.hex"}, biases);
    end

    reg [WEIGHT_BITS - 1:0] weight_at;
    reg [SCALE_BITS - 1:0] scale_at;
    reg [BIAS_BITS - 1:0] bias_at;
    reg [8 * MACS - 1:0] weight_read;
    reg [39:0] scale_read;
    reg signed [31:0] bias_read;
    reg signed [31:0] state_read;
    wire sum_ends;  // the accumulator gets the last products of a neuron

    assign beyond = weight_at >= RESIDENT;

    always @(posedge clk) begin
        if (state_write) state[state_slot] <= state_value;
        state_read <= state[input_slot];
        weight_read <= weights[beyond ? 0 : weight_at];
        scale_read <= scales[scale_at];
        bias_read <= biases[bias_at];
        if (restart) begin
            weight_at <= 0;
            scale_at <= 0;
            bias_at <= 0;
        end else begin
            if (start) weight_at <= weight_at + 1'b1;
            if (input_start || (sum_done && sum_hidden)) scale_at <= scale_at + 1'b1;
            if (sum_ends) bias_at <= bias_at + 1'b1;
        end
    end

    // ---- Activations: a lane for each MAC unit, two halves that layers read and write in turn. ----
    wire [7 * MACS - 1:0] activations;
    genvar g;
    generate
        for (g = 0; g < MACS; g = g + 1) begin : lanes
            reg [6:0] memory [0:(2 << ADDRESS) - 1];
            reg [6:0] value;
            integer i;
            // What was never written is multiplied by weights of 0, which in a simulation is unknown.
            initial for (i = 0; i < (2 << ADDRESS); i = i + 1) memory[i] = 0;
            always @(posedge clk) begin
                if (lane_write[g]) begin
                    memory[lane_address[(ADDRESS + 1) * g +: ADDRESS + 1]] <= lane_value[7 * g +: 7];
                end
                value <= memory[read_at];
            end
            assign activations[7 * g +: 7] = value;
        end
    endgenerate

    // ---- MAC units. ----
    reg read_valid, read_first, read_last, read_hidden, read_streamed;
    reg made_valid, made_first, made_last, made_hidden;
    reg added_valid, added_first, added_last, added_hidden;
    reg sum_done, sum_hidden;
    reg [16 * MACS - 1:0] products;
    reg signed [31:0] total;
    reg signed [31:0] accumulator;
    wire [8 * MACS - 1:0] operand = read_streamed ? held : weight_read;

    integer m;
    reg signed [31:0] gathered;
    always @* begin
        gathered = 0;
        for (m = 0; m < MACS; m = m + 1) begin
            gathered = gathered + {{16{products[16 * m + 15]}}, products[16 * m +: 16]};
        end
    end

    integer p;
    always @(posedge clk) begin
        read_valid <= start;
        read_first <= first;
        read_last <= last;
        read_hidden <= hidden;
        read_streamed <= streamed && beyond;

        made_valid <= read_valid;
        made_first <= read_first;
        made_last <= read_last;
        made_hidden <= read_hidden;
        for (p = 0; p < MACS; p = p + 1) begin
            products[16 * p +: 16] <=
                $signed(operand[8 * p +: 8]) * $signed({1'b0, activations[7 * p +: 7]});
        end

        added_valid <= made_valid;
        added_first <= made_first;
        added_last <= made_last;
        added_hidden <= made_hidden;
        total <= gathered;

        if (added_valid) accumulator <= added_first ? total : accumulator + total;
        sum_done <= sum_ends;
        sum_hidden <= added_hidden;
        if (restart) begin
            read_valid <= 1'b0;
            made_valid <= 1'b0;
            added_valid <= 1'b0;
            sum_done <= 1'b0;
        end
    end
    assign sum_ends = added_valid && added_last;

    // ---- Adder. ----
    assign sum = accumulator + bias_read;
    assign sum_valid = sum_done && !sum_hidden;
    reg biased_valid;
    reg signed [31:0] biased;
    always @(posedge clk) begin
        biased_valid <= !restart && sum_done && sum_hidden;
        biased <= sum;
    end

    // ---- Multiplier, of inputs and of sums; inputs are rounded in a cycle of its own. ----
    reg input_read, input_made, input_rounded;
    reg signed [63:0] made;
    reg [5:0] made_shift;
    reg [6:0] rounded;
    wire unused = &{1'b0, scale_read[39:38]};  // shifts are 62 at most
    wire signed [31:0] factor = input_read ? state_read : biased;
    wire signed [63:0] product = factor * $signed({1'b0, scale_read[31:0]});
    wire signed [63:0] value = input_made ? made : product;
    wire [5:0] shift = input_made ? made_shift : scale_read[37:32];
    wire signed [63:0] half = $signed((64'd1 << shift) >> 1);
    wire signed [63:0] scaled = (value + half) >>> shift;
    wire [6:0] clamped = scaled < 0 ? 7'd0 : scaled > 127 ? 7'd127 : scaled[6:0];

    always @(posedge clk) begin
        input_read <= !restart && input_start;
        input_made <= !restart && input_read;
        input_rounded <= !restart && input_made;
        made <= product;
        made_shift <= scale_read[37:32];
        rounded <= clamped;
    end
    assign result_valid = input_rounded || biased_valid;
    assign result = input_rounded ? rounded : clamped;
endmodule

`default_nettype wire
